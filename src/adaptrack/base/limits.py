"""Upper bounds of requests, each with its unit and reason, and the check that refuses a larger value.

The bounds catch typing errors (a speed of 1e15 m/s, a horizon of 1e9 periods) before they cost memory or hours. They
are far above what a study needs. A request within the bounds may still take long; commands then show the time left.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from adaptrack.base.errors import InvalidInput

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler
    from pydantic_core.core_schema import CoreSchema


class RequestLimit(NamedTuple):
    """The largest accepted value of a quantity in a request."""

    most: float
    unit: str
    """SI unit, or the noun that is counted; empty for a pure number."""
    reason: str
    """Clause with the reason, often the memory or the computation time of the largest request."""

    @property
    def range(self) -> str:
        """The accepted range of a quantity that starts at 1, for the help of an option."""
        return f"1 to {self.most:,}"

    def __str__(self) -> str:
        return f"at most {self.most:,}{self.unit and ' '}{self.unit} ({self.reason})"

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check the type first and then the bound, as in `Annotated[Finite, MAX_SPEED]`."""
        from pydantic_core.core_schema import no_info_after_validator_function  # slow import that `--help` avoids

        def within(value: float) -> float:
            if value > self.most:
                raise ValueError(f"{self}.")
            return value

        return no_info_after_validator_function(within, handler(source))


# -- a run ------------------------------------------------------------------------------------------------------------
MAX_SPEED = RequestLimit(100, "m/s", "360 km/h; at higher speeds tyre dynamics need ever smaller integration steps")
DURATION = RequestLimit(100_000, "s", "a little over a day")
PERIODS = RequestLimit(2_000_000, "control periods", "a day at 0.05 s, 0.7 GB")
MAX_STEPS = RequestLimit(
    10_000, "steps", "steps of 5 us at a period of 0.05 s; a plant with faster dynamics can sub-step in its own code"
)

TABLE_ROWS = RequestLimit(5_000_000, "rows", "14 hours at 100 Hz; cut the table, or leave out rows")

# -- a road -----------------------------------------------------------------------------------------------------------
ROAD_LENGTH = RequestLimit(2_000_000, "m of road", "its speed is planned at every metre: 3 GB, and some minutes")
MAX_GRADE = 0.4
"""dz/ds of a road, either way: the steepest streets have 0.35. A value of 5 is probably in per cent."""
TURNS = RequestLimit(10_000, "rad", "heading change of one road element; 10,000 rad need 3 MB")

# -- a controller -----------------------------------------------------------------------------------------------------
PREDICTION_HORIZON = RequestLimit(1000, "control periods", "100 s at 0.1 s; a step then takes milliseconds")
CONTROL_HORIZON = RequestLimit(
    200, "control periods", "the time of a QP grows with the cube of the number of its moves"
)
LAGUERRE_TERMS = RequestLimit(200, "functions", CONTROL_HORIZON.reason)

# -- a campaign of the paper ------------------------------------------------------------------------------------------
NOISE_SEEDS = RequestLimit(1000, "noise seeds", "the time is proportional to their number; 4 are usual")
LANDSCAPE_COSTS = RequestLimit(500_000_000, "costs of all tunings at all operating points", "2 GB")
WORKERS = RequestLimit(1024, "threads", "more than the cores of any machine")

# -- a comparison -----------------------------------------------------------------------------------------------------
DRIVES = RequestLimit(10_000, "random drives", "1.3 GB; more drives would repeat those of the next seed")
OPERATING_POINTS = RequestLimit(100_000, "operating points", "1.7 GB, and a search of 0.5 s on one core for each")
MAX_SEED = RequestLimit(10_000, "", "the number of a random drive is computed from the seed")


def check_limit(quantity: str, value: float, limit: RequestLimit) -> None:
    """Refuse a value above its bound: "<quantity> = <value>: at most <most> <unit> (<reason>)" is an InvalidInput."""
    if value > limit.most:
        number = str(value) if isinstance(value, int) and value < 10**15 else f"{float(min(value, 10**300)):.6g}"
        raise InvalidInput(f"{quantity} = {number}: {limit}.")
