"""A controller in anybody's loop, as kernels: samples with time stamps in, commands and statuses out.

    tracker_give(tracker)                   a call: what was measured
    while tracker_before(tracker) > 0:      a control instant to be gone through: measurement, station, road ahead
        the controller's step               compiled or not
        tracker_after(tracker)              its command

`step` has whole calls around a compiled controller. All that a tracker remembers is one row of numbers.
"""
