"""The numbers of the paper's MPC of a car."""

from __future__ import annotations

import math

from ..kernel import OK, Place, Row, exported, float64, int64, packer
from ..models import single_track
from ..models.car import CarRow, SingleTrackCar
from ..models.contract import MEASUREMENT
from .belief import ANGLE, MOVE
from .informed import CAR_WRONG, LOOP_WRONG, MEMORY_TOO_SMALL, Constants, is_a_car
from .tuning import PAPER_TUNING

_pack = packer(SingleTrackCar)
_MODEL, _STATES = len(SingleTrackCar._fields), len(single_track.SINGLE_TRACK_STATE)


@exported(int64(Row(CarRow), float64, Place(Constants)))
def published_constants(car, period, constants):
    """Write tuning and limits of the paper's table, and its model of a car; period: s.

    Of the settings only those of the loop; estimator, learner and turning are not used. `OK`, or what is wrong: then
    nothing is written.
    """
    tuning, model, states = constants.tuning, constants.model, constants.states
    if not is_a_car(car):
        return CAR_WRONG
    if not 0.0 < period < math.inf:
        return LOOP_WRONG
    if constants.settings.size < 1 or tuning.size < len(PAPER_TUNING) or model.size < _MODEL or states.size != _STATES:
        return MEMORY_TOO_SMALL
    s = constants.settings[0]
    s.period, s.delay, s.ahead, s.error_max = period, 0.0, 0.0, math.inf
    s.move_min, s.move_max, s.angle_min, s.angle_max = -MOVE, MOVE, -ANGLE, ANGLE
    s.informed, s.learns = 0, 0
    tuning[0], tuning[1], tuning[2], tuning[3] = PAPER_TUNING
    _pack(model, 0, car)
    states[0], states[1], states[2], states[3] = MEASUREMENT.vy, MEASUREMENT.yaw, MEASUREMENT.yaw_rate, MEASUREMENT.y
    return OK
