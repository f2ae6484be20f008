"""Camera poses corrected while the field is learnt, with localization's covariance as the prior."""
