"""Elementary functions, counted random numbers, and eight numbers as one vector."""
