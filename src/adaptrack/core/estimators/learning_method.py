"""How a car is learned while driving: the constants of the learner (`estimators.learning`), each with its reason.

Users set what has bounds (`adaptrack.Learning`). An experiment replaces any other in a subclass of `Learning`:
``defaults = Learning.defaults._replace(wind=0.5)``.
"""

from __future__ import annotations

import math

from ..kernel import Field, record

MAX_HYPOTHESES = 12
"""Of the lag and of the dead time."""
LearningMethod = record("LearningMethod", (
    Field("lags", "", 2, "hypotheses of the lag, evenly within its range", f"[1, {MAX_HYPOTHESES}]"),
    Field("dead_times", "", 2, "hypotheses of the dead time, evenly within its range", f"[1, {MAX_HYPOTHESES}]"),
    Field("bias", "rad", math.nan, "largest bias of the steering to either side, never exceeded; unknown: the range "
          "begins at 0.035 rad and may widen to 0.07 rad", "[0, inf)"),
    Field("balance", "", math.nan, "largest factor on front over rear stiffness to either side, never exceeded; "
          "unknown: the range begins at 2 and may widen to 4", "[1, inf)"),

    # where the filters begin, and what comes and goes
    Field("rearward_share", "", 1.0, "share of the open range of the centre of mass by which it is assumed further "
          "back: a car assumed too heavy in front leaves the road where it oversteers, the opposite costs little"),
    Field("bank", "m/s^2", 0.2, "standard deviation of the pull of a banked road"),
    Field("bank_time", "s", 20.0, "correlation time of the bank"),
    Field("wind", "m/s^2", 0.35, "change of side wind within a second, for a car of `synthesis.learner.WINDY` kg"),
    Field("wind_time", "s", 3.0, "correlation time of a gust"),
    Field("friction", "", 0.7, "median of friction, to which it returns without evidence"),
    Field("friction_sigma", "", 0.4, "standard deviation of the logarithm of friction"),
    Field("friction_time", "s", 15.0, "correlation time of friction"),

    # random walks: standard deviations after a second
    Field("drift_vy", "m/s", 0.03, "of the lateral velocity, beyond the model"),
    Field("drift_yaw_rate", "rad/s", 0.02, "of the yaw rate, beyond the model"),
    Field("drift_stiffness", "", 0.003, "of the logarithm of the stiffness"),
    Field("drift_balance", "", 0.0005, "of half the logarithm of the balance"),
    Field("drift_bias", "rad", 0.00003, "of the bias"),
    Field("drift_delay", "s", 0.0015, "of lag and of dead time"),
    Field("sliding", "s^0.5", 0.1, "of an axle's impulse over F^2/F_z, as in `synthesis.filter.Drifts`"),

    # evidence
    Field("angle_error", "rad", 0.002, "error of the steering model, beyond the noise of the wheel-angle sensor"),
    Field("innovation_bound", "", 5.0, "standard deviations up to which an innovation counts"),
    Field("evidence_time", "s", 120.0, "of exciting driving, after which evidence about the delay is forgotten"),
    Field("tempering", "", 0.5, "share of a log-likelihood that counts: successive innovations are not independent"),
    Field("contradiction_time", "s", 3.0, "over which squared innovations are averaged to find a contradiction"),
    Field("return_time", "s", 30.0, "shortest time constant of a return to the prior's variances in a contradiction"),
    Field("noise_range", "", 4.0, "factor within which the noise of a sensor may differ from the specified one"),
    Field("noise_time", "s", 20.0, "over which the noise of a sensor is averaged"),

    # what is reported: the filters know nothing of relaxation and load of the tyres, nor of the centre of mass
    Field("sigma_inflation", "", 2.0, "factor on the standard deviations of the filters"),
    Field("unmodelled_lag", "s", 0.03, "standard deviation that no amount of driving reduces"),
    Field("unmodelled_dead_time", "s", 0.02, "standard deviation that no amount of driving reduces"),
    Field("unmodelled_delay", "s", 0.015, "standard deviation of lag plus dead time that driving does not reduce"),
    Field("unmodelled_stiffness", "", 0.1, "standard deviation of the logarithm that driving does not reduce"),
    Field("unmodelled_balance", "", 0.3, "standard deviation of the logarithm that driving does not reduce"),
    Field("unmodelled_bias", "rad", 0.0015, "standard deviation that no amount of driving reduces"),

    # what the controller assumes. Less caution (0.06 s, 0.6 and a quantile of 1) made the first 5 s cost 4.7 times
    # the truth's instead of 3.5, on 40 cars; without v_y R is larger already (`synthesis.tuning.UNSEEN`)
    Field("delay_quantile", "", 0.5, "standard deviations of the delay by which it is assumed longer than its mean"),
    Field("delay_tolerance", "s", 0.12, "standard deviation of the delay that doubles R, with a measured v_y"),
    Field("delay_tolerance_blind", "s", 0.3, "standard deviation of the delay that doubles R, without"),
    Field("stiffness_tolerance", "", 0.6, "standard deviation of the log stiffness that doubles R, with v_y"),
    Field("stiffness_tolerance_blind", "", 2.0, "standard deviation of the log stiffness that doubles R, without"),
    Field("max_delay_caution", "", 16.0, "largest factor on R for an uncertain delay"),
    Field("doubt_caution", "", 4.0, "factor on R at the end of a range, and in a contradiction"),
    Field("doubt_time", "s", 1.0, "time constant of that factor"),
    Field("max_delay_rate", "s/s", 2.0, "fastest change of the lag and of the dead time that are assumed"),
    Field("max_stiffness_rate", "1/s", 5.0, "fastest change of the logarithms of stiffness and balance"),
    Field("max_bias_rate", "rad/s", 0.1, "fastest change of the bias"),
    Field("wheel_drift_rate", "rad/s", 0.05, "steering rate by which an uncertain delay displaces the wheels"),

    # a change of the delay while driving, and what the grip limits: without a change the statistic stays below 2 in
    # most of 42 drives; near the grip the model is wrong
    Field("change_time", "s", 2.0, "of excited driving, over which a change of the delay is tested"),
    Field("change_begin", "s", 10.0, "of excited driving, before which it is not tested: the rest is not known yet"),
    Field("change_threshold", "", 2.5, "standard deviations from which on the delay has changed"),
    Field("least_change", "s", 0.03, "smallest change of lag and dead time that counts"),
    Field("max_change", "s", 0.1, "largest standard deviation by which one test widens lag or dead time"),
    Field("weak_information", "1/s^2", 25.0, "prior information in the test: a standard deviation of 0.2 s"),
    Field("least_information", "1/s^3", 50.0, "information about the dead time in a second of excited driving"),
    Field("test_grip_use", "", 0.6, "share of the grip beyond which the delay is not tested"),
    Field("least_tyre_speed", "m/s", 8.0, "speed below which, without v_y, stiffness, balance and friction are not "
          "learned: relaxing tyres look soft there, and with 0 m/s stop-and-go was 1.6 to 1.9 times worse"),
    Field("delay_grip_use", "", 0.8, "share of the grip beyond which the delay is not learned"),
))  # fmt: skip
"""Settings and constants of the learner."""
