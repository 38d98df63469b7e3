"""A controller in anybody's loop, as kernels: samples with time stamps in, commands and statuses out.

`tracker_step` of `step` is a whole call: take it in, go through its control instants by `loop.period_of`, then the
speed control. All that a tracker remembers is one row of numbers.
"""
