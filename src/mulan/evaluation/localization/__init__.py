"""Localization against what is possible: simulated cases beside bounds, real recordings, online."""
