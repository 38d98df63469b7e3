"""Driving: the world, single runs and batches, their records (`Trajectory`) and measures (`Metrics`)."""
