"""Recordings of other projects brought in: foreign bags, COLMAP models, trajectories with images."""
