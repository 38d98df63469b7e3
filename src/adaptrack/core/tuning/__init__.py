"""Tuning of a controller by a particle swarm."""
