"""Choosing views from a set of photographs: every rule on the same pools, from the same first views."""
