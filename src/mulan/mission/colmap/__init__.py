"""Sparse models of COLMAP: cameras, posed images, points; binary and text (colmap.github.io/format.html)."""
