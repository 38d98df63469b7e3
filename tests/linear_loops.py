"""The linear closed loop of a plant and an MPC at one speed."""

from adaptrack.analysis.linearisation import SampleAges, laws, linear_estimator, sampled
from adaptrack.analysis.stability import loops
from adaptrack.core.maths.portable import spectral_radius


def loop_radius(plant, mpc, speed, *, tuning=None, profile="paper", **options):
    """Spectral radius of the loop over one control period; tuning: None for the MPC's own; options: of `sampled`."""
    linear = sampled(plant, mpc.period, speed, profile=profile, **options)
    estimator = linear_estimator(mpc, speed, SampleAges.of(profile))
    controllers = laws(mpc, speed, (tuning or mpc.tuning).as_array(), estimator)
    return float(spectral_radius(loops(linear, controllers))[0])
