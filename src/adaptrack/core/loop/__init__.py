"""The loop: the simulated world, its control period, and those who drive by it."""
