"""Long drives of the speed control with random cars, paths, plans, stops, slopes, calls and faults of the sensors.

    python -m tools.fuzz speed --steps 2000000 --seed 1                   # through the exported C library
    python -m tools.fuzz speed --steps 1000000 --seed 101 --way tracker   # through `adaptrack.Tracker`
    python -m tools.fuzz speed --steps 30000 --seed 3 --way both          # the bits of both are compared
    python -m tools.fuzz speed --seed 1 --drive 17 --trace                # one drive again, row by row
    python -m tools.fuzz speed --seed 1 --drive 17 --shorten              # the simplest drive that fails alike
    ADAPTRACK_KERNELS=interpreted python -m tools.fuzz.speed.bound        # lines that a call with a far time runs

A drive follows from the seed and its number alone. Of its sensors, one of five lists says what fails:

    healthy   nothing; half of these drives have calls in an odd order
    visible   `faults.VISIBLE`: a sample shows by itself that it is wrong. The car is never faster than the plan by more
              than 1 m/s.
    cross     `faults.CROSS`: a second signal contradicts the first one. The car is faster than the plan + 1 m/s for at
              most 2 s, then it brakes with comfort.
    hidden    `faults.HIDDEN`: no signal contradicts. How far the car goes wrong is counted.
    double    two faults of the lists visible and cross at a time. Counted likewise.

`claims` says what must hold. Everywhere, requests are finite and within the limits of the car, and a call returns.
"""
