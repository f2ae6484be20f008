"""MULAN: multi-robot radiance fields from cameras, odometry, WiFi bearings and UWB ranges."""

__version__ = "0.1.0"
