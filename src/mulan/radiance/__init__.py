"""The radiance field itself: encoding, networks, occupancy, volume rendering. Knows nothing of robots."""
