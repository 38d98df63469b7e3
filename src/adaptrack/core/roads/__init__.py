"""Roads and paths: a point on them, the foot of a car, a line from points of a planner."""
