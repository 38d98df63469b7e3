"""Linear closed loops, their stability margins and certificates, and the feasible speeds of a car."""
