"""Controller synthesis: from a car, a belief and a tuning to the constant numbers of a controller.

    car         what is known of a car and how well; the rest estimated from mass and wheelbase
    belief      what is believed of the steering, and how far it may be wrong
    tuning      horizons and weights for a loop
    filter      the numbers of the Kalman filter
    learner     those of the learner, and what it remembers before its first step
    laws        those of pure pursuit, Stanley and LQR; a Riccati equation
    mpc         all numbers of an MPC at once

NaN means not given. Memory is the caller's; no kernel keeps any.
"""
