"""Follow the trajectories of a planner, each of which replaces the one before while the car drives.

`clock` converts the stamp of a trajectory to the clock of the tracker. `condition` turns its points into places with
times and speeds. `splice` joins these to the line that the car follows. The car steers by its position on the new line,
and `timing` corrects its speed by the time. `meant_line` detects a planner that hides the error of the controller.
"""
