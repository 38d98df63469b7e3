"""How a car is learned while driving: the constants of the learner (`estimators.learning`), each with its reason.

Users set what has bounds (`adaptrack.Learning`). An experiment replaces any other in a subclass of `Learning`:
``defaults = Learning.defaults._replace(wind=0.5)``.
"""

from __future__ import annotations

import math

from ..kernel import Setting, defaults, record

MAX_HYPOTHESES = 12
"""Of the lag and of the dead time."""
LearningMethod = record("LearningMethod", (
    Setting("lags", "", 2, "hypotheses of the lag, evenly within its range", f"[1, {MAX_HYPOTHESES}]"),
    Setting("dead_times", "", 2, "hypotheses of the dead time, evenly within its range", f"[1, {MAX_HYPOTHESES}]"),
    Setting("bias", "rad", math.nan, "largest bias of the steering to either side, never exceeded; unknown: the range "
            "begins at 0.035 rad and may widen to 0.07 rad", "[0, inf)"),
    Setting("balance", "", math.nan, "largest factor on front over rear stiffness to either side, never exceeded; "
            "unknown: the range begins at 2 and may widen to 4", "[1, inf)"),

    # where the filters begin, and what comes and goes
    Setting("rearward_share", "", 1.0, "share of the open range of the centre of mass by which it is assumed further "
            "back: a car assumed too heavy in front leaves the road where it oversteers, the opposite costs little"),
    Setting("bank", "m/s^2", 0.2, "standard deviation of the pull of a banked road"),
    Setting("bank_time", "s", 20.0, "correlation time of the bank"),
    Setting("wind", "m/s^2", 0.35, "change of side wind within a second, for a car of `synthesis.learner.WINDY` kg"),
    Setting("wind_time", "s", 3.0, "correlation time of a gust"),
    Setting("friction", "", 0.7, "median of friction, to which it returns without evidence"),
    Setting("friction_sigma", "", 0.4, "standard deviation of the logarithm of friction"),
    Setting("friction_time", "s", 15.0, "correlation time of friction"),

    # random walks: standard deviations after a second
    Setting("drift_vy", "m/s", 0.03, "of the lateral velocity, beyond the model"),
    Setting("drift_yaw_rate", "rad/s", 0.02, "of the yaw rate, beyond the model"),
    Setting("drift_stiffness", "", 0.003, "of the logarithm of the stiffness"),
    Setting("drift_balance", "", 0.0005, "of half the logarithm of the balance"),
    Setting("drift_bias", "rad", 0.00003, "of the bias"),
    Setting("drift_delay", "s", 0.0005, "of lag and of dead time"),
    Setting("sliding", "s^0.5", 0.1, "of an axle's impulse over F^2/F_z, as in `synthesis.filter.Drifts`"),

    # evidence
    Setting("angle_error", "rad", 0.002, "error of the steering model, beyond the noise of the wheel-angle sensor"),
    Setting("innovation_bound", "", 5.0, "standard deviations up to which an innovation counts"),
    Setting("evidence_time", "s", 120.0, "of exciting driving, after which evidence about the delay is forgotten"),
    Setting("tempering", "", 0.5, "share of a log-likelihood that counts: successive innovations are not independent"),
    Setting("contradiction_time", "s", 3.0, "over which squared innovations are averaged to find a contradiction"),
    Setting("return_time", "s", 3.0, "time constant of the return to the prior's variances in a contradiction"),
    Setting("noise_range", "", 4.0, "factor within which the noise of a sensor may differ from the specified one"),
    Setting("noise_time", "s", 20.0, "over which the noise of a sensor is averaged"),

    # what is reported: the filters know nothing of relaxation and load of the tyres, nor of the centre of mass
    Setting("sigma_inflation", "", 2.0, "factor on the standard deviations of the filters"),
    Setting("unmodelled_lag", "s", 0.03, "standard deviation that no amount of driving reduces"),
    Setting("unmodelled_dead_time", "s", 0.02, "standard deviation that no amount of driving reduces"),
    Setting("unmodelled_delay", "s", 0.015, "standard deviation of lag plus dead time that driving does not reduce"),
    Setting("unmodelled_stiffness", "", 0.1, "standard deviation of the logarithm that driving does not reduce"),
    Setting("unmodelled_balance", "", 0.3, "standard deviation of the logarithm that driving does not reduce"),
    Setting("unmodelled_bias", "rad", 0.0015, "standard deviation that no amount of driving reduces"),

    # what the controller assumes. Less caution (0.06 s, 0.6 and a quantile of 1) made the first 5 s cost 4.7 times
    # the truth's instead of 3.5, on 40 cars; without v_y R is larger already (`synthesis.tuning.UNSEEN`)
    Setting("delay_quantile", "", 0.5, "standard deviations of the delay by which it is assumed longer than its mean"),
    Setting("delay_tolerance", "s", 0.12, "standard deviation of the delay that doubles R, with a measured v_y"),
    Setting("delay_tolerance_blind", "s", 0.3, "standard deviation of the delay that doubles R, without"),
    Setting("stiffness_tolerance", "", 0.6, "standard deviation of the log stiffness that doubles R, with v_y"),
    Setting("stiffness_tolerance_blind", "", 2.0, "standard deviation of the log stiffness that doubles R, without"),
    Setting("max_delay_caution", "", 16.0, "largest factor on R for an uncertain delay"),
    Setting("doubt_caution", "", 4.0, "factor on R at the end of a range, and in a contradiction"),
    Setting("doubt_time", "s", 1.0, "time constant of that factor"),
    Setting("max_delay_rate", "s/s", 2.0, "fastest change of the lag and of the dead time that are assumed"),
    Setting("max_stiffness_rate", "1/s", 5.0, "fastest change of the logarithms of stiffness and balance"),
    Setting("max_bias_rate", "rad/s", 0.1, "fastest change of the bias"),
    Setting("wheel_drift_rate", "rad/s", 0.05, "steering rate by which an uncertain delay displaces the wheels"),
))  # fmt: skip
"""Settings and constants of the learner."""
DEFAULT_METHOD = defaults(LearningMethod)
