"""Finding the tuning that an operating point needs: the particle swarm, the cost it minimises, and campaigns of it."""
