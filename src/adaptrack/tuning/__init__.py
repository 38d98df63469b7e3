"""Finding the tuning that a condition needs: the particle swarm, the cost it minimises, and campaigns of it."""
