"""How large a request may be: every bound with its unit and its reason, and the one form in which it is refused.

A bound stops a slip of the pen (a speed of 1e15 m/s, a horizon of 1e9 periods) before memory or hours are spent on it;
none is near what a study needs. What fits its bounds and still takes long says so: commands show the time left.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from adaptrack.base.errors import InvalidInput

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler
    from pydantic_core.core_schema import CoreSchema


class RequestLimit(NamedTuple):
    """The largest value of a request."""

    most: float
    unit: str
    """Noun of a count, or the SI unit; empty for a number without one."""
    reason: str
    """a clause that says why, with the memory or the time of the largest request"""

    @property
    def range(self) -> str:
        """For the help of an option that counts from 1."""
        return f"1 to {self.most:,}"

    def __str__(self) -> str:
        return f"at most {self.most:,}{self.unit and ' '}{self.unit} ({self.reason})"

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Beside a type in an annotation the bound is checked with it."""
        from pydantic_core.core_schema import no_info_after_validator_function  # the help of commands needs none

        def within(value: float) -> float:
            if value > self.most:
                raise ValueError(f"{self}.")
            return value

        return no_info_after_validator_function(within, handler(source))


# -- a run ------------------------------------------------------------------------------------------------------------
MAX_SPEED = RequestLimit(100, "m/s", "360 km/h; faster tyres need ever finer integration steps")
DURATION = RequestLimit(100_000, "s", "a little over a day")
PERIODS = RequestLimit(2_000_000, "control periods", "a day at 0.05 s, 0.7 GB")
MAX_STEPS = RequestLimit(
    10_000, "steps", "5 us each in 0.05 s; a plant that needs shorter ones takes them within its step"
)

# -- a road -----------------------------------------------------------------------------------------------------------
ROAD_LENGTH = RequestLimit(2_000_000, "m of road", "its speed is planned at every metre: 3 GB, and some minutes")
MAX_GRADE = 0.4
"""dz/ds of a road, either way: the steepest streets have 0.35, and 5 is per cent."""
TURNS = RequestLimit(10_000, "rad", "one element; each is a piece of the road, 3 MB in all")

# -- a controller -----------------------------------------------------------------------------------------------------
PREDICTION_HORIZON = RequestLimit(1000, "control periods", "100 s at 0.1 s; a step then takes milliseconds")
CONTROL_HORIZON = RequestLimit(
    200, "control periods", "the time of a QP grows with the cube of the number of its moves"
)
LAGUERRE_TERMS = RequestLimit(200, "functions", CONTROL_HORIZON.reason)

# -- a campaign -------------------------------------------------------------------------------------------------------
NOISE_SEEDS = RequestLimit(1000, "noise seeds", "each multiplies the time of a campaign; 4 are usual")
LANDSCAPE = RequestLimit(500_000_000, "costs (operating points x tunings of the library)", "2 GB")
WORKERS = RequestLimit(1024, "threads", "more than the cores of any machine")

# -- a comparison -----------------------------------------------------------------------------------------------------
DRIVES = RequestLimit(10_000, "random drives", "1.3 GB; further ones would be those of the next seed")
OPERATING_POINTS = RequestLimit(100_000, "operating points", "1.7 GB, and a search of 0.5 s on one core for each")
MAX_SEED = RequestLimit(10_000, "", "it numbers the drives")


def check_limit(quantity: str, value: float, limit: RequestLimit) -> None:
    """Refuse a value above its bound.

    Raises
    ------
    InvalidInput
        "<what> = <value>: at most <most> <unit> (<reason>)."
    """
    if value > limit.most:
        number = str(value) if isinstance(value, int) and value < 10**15 else f"{float(min(value, 10**300)):.6g}"
        raise InvalidInput(f"{quantity} = {number}: {limit}.")
