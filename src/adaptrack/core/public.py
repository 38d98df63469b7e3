"""What kernels outside the core may use: others' controllers and plants, environments, kernels of one's own.

This module is the core's contract with them: whatever stands here keeps its name and its meaning, and nothing else of
the core may be imported from outside the package's own rooms. A linter holds `gym` to it, a test the plug-ins.

=====================  =============================================================================================
writing a kernel       `inlined`, `exported`, `Caller`, `address_of`, `member`, `compiles`; types (`float64`, `vector`,
                       `void`, `several`, ...); records (`record`, `columns`, `rows`, `unpacker`, `packer`, `viewer`,
                       `size_of`, `Place`, `Resident`); `local`, `shaped`, `fma`. See `core.kernel` for the rules
functions              the same bits on every processor: `exp`, `log`, `sin`, `atan2`, `hypot`, ...; of nine digits and
                       quicker in loops: `fast_sine`, `fast_cosine`, `fast_arctangent`, ...; `portable`: of arrays,
                       whose type is `Array`
a controller           its call (`LAW_SIGNATURE`, `COMMON_PARAMETERS`, `read_situation`) and what must hold (`limited`,
                       `all_finite`), see `core.controllers.contract`
the path ahead         `path_at`, `path_ahead`, `planned_speed`, `wrapped`, `Direction`; the linear model in path
                       coordinates, `path_model`; `node_below` in grids of gains
quadratic programmes   `qp` (the problem and its arrays), `factorise`, `active_set`, `padded`
counted random         `counted_uniform`, `counted_normal`: the same number for the same counters, in any order; by hand
                       `random_bits` of counters, and a `random_unit` of bits
a plant                `MOTION_STATES` and `PlantState`, the input of a right-hand side (`PLANT_INPUT`), `wind_load`,
                       `layout_of` parameters
a simulated run        episodes of a batch: `Episodes`, `renew`, `drive_on`; what an agent observes: `ObservationSpace`,
                       `write_one_observation`, `write_observations`, `write_variables`; rows of the signals and of the
                       state of a plant, `SIGNAL` and `PLANT_STATE`
=====================  =============================================================================================
"""

from .controllers.contract import (
    COMMON_PARAMETERS,
    LAW_SIGNATURE,
    MIN_LAW_SPEED,
    STANDSTILL_SPEED,
    Direction,
    all_finite,
    limited,
    path_ahead,
    path_at,
    planned_speed,
    read_situation,
    wrapped,
)
from .controllers.lqr import node_below
from .estimators.learning import BELIEF_NAMES
from .estimators.learning import BELIEFS_OFFSET as LEARNED
from .kernel import (
    Caller,
    Place,
    Resident,
    address_of,
    boolean,
    columns,
    cube,
    exported,
    float64,
    fma,
    inlined,
    int64,
    int_vector,
    local,
    matrix,
    packer,
    record,
    rows,
    several,
    shaped,
    size_of,
    unpacker,
    vector,
    viewer,
    void,
)
from .maths import portable
from .maths.bits import whole
from .maths.exact import ceil, clip, floor, fmod, sqrt, square
from .maths.exponential import exp, hypot, log
from .maths.fast import fast_arctangent, fast_arctangent_of_ratio, fast_cosine, fast_sine
from .maths.portable import Array
from .maths.random import counted_normal, counted_uniform
from .maths.random import output as random_bits
from .maths.random import unit as random_unit
from .maths.trigonometric import asin, atan, atan2, cos, sin, tan
from .maths.vectors import padded
from .member import compiles, member
from .models import path as path_model
from .models.contract import MEASUREMENT
from .physics.forces import GRAVITY, STANDING_SPEED, wind_load
from .plants.contract import MOTION_STATES, PLANT_STATE, SLOTS, PlantState
from .plants.user import U as PLANT_INPUT
from .plants.user import layout_of
from .qp import problem as qp
from .qp.active_set import active_set
from .qp.factor import factorise
from .simulation.episode import (
    EPISODE,
    EPISODE_ARRIVED,
    EPISODE_FAILED,
    EPISODE_RUNS,
    MIN_APPROACH_SPEED,
    Episodes,
    ObservationSpace,
    drive_on,
    renew,
    write_observations,
    write_one_observation,
    write_variables,
)
from .simulation.world import HOLDING_DECELERATION, SIGNAL
