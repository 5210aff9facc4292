"""Recorded trajectories of targets: their rows, and the CSV files that they come from."""
