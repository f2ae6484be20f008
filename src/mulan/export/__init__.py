"""What a run gives to other programs: image sets, models, trajectories, meshes, points, videos."""
