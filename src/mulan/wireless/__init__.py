"""CSI and UWB in; bearings and ranges with honest uncertainty out."""
