"""The simulated world: cars with sensors and drivers, single runs and batches, episodes, what a page shows."""
