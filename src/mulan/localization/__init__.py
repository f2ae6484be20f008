"""Odometry, bearings and ranges in; every robot's poses in one frame, with covariance, out."""
