"""Gymnasium environments in which an agent steers a car along its road, or chooses the tuning of its MPC.

``import adaptrack.gym`` registers `adaptrack/PathTracking-v0` and `adaptrack/MPCTuning-v0` for ``gymnasium.make`` and
``gymnasium.make_vec``. ``gymnasium.make("adaptrack.gym:adaptrack/PathTracking-v0")`` needs no such import.
"""

from __future__ import annotations

from adaptrack.base.errors import MissingExtra

try:
    import gymnasium
except ModuleNotFoundError:
    raise MissingExtra("adaptrack.gym needs Gymnasium: python -m pip install 'adaptrack[gym]'") from None

from adaptrack.gym.mpc_tuning import MPCTuningEnv, MPCTuningVectorEnv
from adaptrack.gym.path_tracking import PathTrackingEnv, PathTrackingVectorEnv
from adaptrack.gym.task import Task

__all__ = ["MPCTuningEnv", "MPCTuningVectorEnv", "PathTrackingEnv", "PathTrackingVectorEnv", "Task"]

for _name, _environment, _vector_environment in (
    ("adaptrack/PathTracking-v0", PathTrackingEnv, PathTrackingVectorEnv),
    ("adaptrack/MPCTuning-v0", MPCTuningEnv, MPCTuningVectorEnv),
):
    if _name not in gymnasium.registry:
        gymnasium.register(
            _name,
            entry_point=f"{_environment.__module__}:{_environment.__name__}",
            vector_entry_point=f"{_vector_environment.__module__}:{_vector_environment.__name__}",
        )
