"""The loop, live: robots and a base station over the network."""
