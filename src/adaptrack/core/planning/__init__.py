"""From a road to what is driven: the fastest speed along it, and a drive's samples at the control instants.

    station_table  what lies along a road (friction, bank, grade, speed limit, width), and the road's edges
    cornering      how hard a car can corner
    cells          the places of a plan, and what the road says between neighbouring ones
    speed          the fastest speed along a road
    drive          a plan in time, and the samples of a drive

Memory is the caller's; no kernel keeps any. Another program calls, in this order:

    path_words, path_through            (`core.roads.path`) points -> a `Centreline`, which `speed.Planning` holds
    plan_places                         how many places the plan has; then `Planning.table` is (PLAN, places)
    plan_along_road                     the fastest speed, into `Planning.table`; or
    plan_constant                       one speed all along the road
    drive_periods                       how many control periods n a `drive.RoadDriveRecord` along that plan lasts
    drive_samples                       its samples, (`core.simulation.world.SIGNAL`, n + 1)
    drive_start                         where the car begins
    road_edges                          to draw the road

A scenario without a road has its reference, speed, friction, wind, bank and grade in its samples: `complete_samples`
writes the rest of them. Rows of a table lie one behind the other, so that a row of it is a vector: the plan that a
drive takes is the rows `s`, `speed` and `time` of the table.
"""
