"""Following a planner: trajectories that come anew while the car drives, their clocks, and who drives when they fail.

A trajectory is taken in whole (`take`): its stamp is put on the clock of the tracker, its points become places with
times (`condition`), and these are joined to the line that the car follows (`splice`). The car then steers by its place
and drives by the time (`timing`). A planner that falls silent gives way to a fallback (`who_drives`).
"""
