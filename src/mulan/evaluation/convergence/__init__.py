"""How far off a robot may be believed for its poses to come right, and whether failures are told."""
