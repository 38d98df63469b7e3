"""Environments for Gymnasium: steer a car along its road, or choose the tuning of its MPC.

After ``import adaptrack.gym`` ``gymnasium.make`` and ``gymnasium.make_vec`` know `adaptrack/PathTracking-v0` and
`adaptrack/MPCTuning-v0`; ``gymnasium.make("adaptrack.gym:adaptrack/PathTracking-v0")`` imports it itself.
"""

from __future__ import annotations

from adaptrack.base.errors import MissingExtra

try:
    import gymnasium
except ModuleNotFoundError:
    raise MissingExtra("adaptrack.gym needs Gymnasium: python -m pip install 'adaptrack[gym]'") from None

from adaptrack.gym.mpc_tuning import MPCTuningEnv
from adaptrack.gym.path_tracking import PathTrackingEnv
from adaptrack.gym.task import Task
from adaptrack.gym.vector import MPCTuningVectorEnv, PathTrackingVectorEnv

__all__ = ["MPCTuningEnv", "MPCTuningVectorEnv", "PathTrackingEnv", "PathTrackingVectorEnv", "Task"]

for _name, _single, _several in (
    ("adaptrack/PathTracking-v0", PathTrackingEnv, PathTrackingVectorEnv),
    ("adaptrack/MPCTuning-v0", MPCTuningEnv, MPCTuningVectorEnv),
):
    if _name not in gymnasium.registry:
        gymnasium.register(
            _name,
            entry_point=f"{_single.__module__}:{_single.__name__}",
            vector_entry_point=f"{_several.__module__}:{_several.__name__}",
        )
