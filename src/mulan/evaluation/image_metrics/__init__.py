"""Further figures of merit of rendered views: perceptual distances and the calibration of the variance."""
