"""The paper's second table: the hardware experiment, with motion capture, drifting odometry and COLMAP."""
