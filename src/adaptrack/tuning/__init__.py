"""Search for the best tuning of a controller: the particle swarm, its cost functions, and the command `tune`."""
