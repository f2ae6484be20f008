"""Calibrated range models on recordings they were not fitted to."""
