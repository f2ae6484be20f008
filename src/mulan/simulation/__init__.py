"""A world that makes missions: photographs, radio, odometry and motion, all deterministic given a seed."""
