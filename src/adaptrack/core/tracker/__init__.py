"""A controller in anybody's loop, as kernels: samples with time stamps in, commands and statuses out.

    tracker_take(tracker)                   a call: what was measured
    while tracker_prepare(tracker) > 0:      a control instant to be gone through: measurement, station, road ahead
        the controller's step               compiled or not
        tracker_conclude(tracker)              its command

`step` has whole calls around a compiled controller. All that a tracker remembers is one row of numbers.
"""
