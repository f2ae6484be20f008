"""Metrics and the protocols behind every published number."""
