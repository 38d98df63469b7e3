from .functions import (
    Function as Function,
    Network as Network,
    Number as Number,
    Sugeno as Sugeno,
    Table as Table,
    register_function as register_function,
)
from .schedule import (
    ENTRIES as ENTRIES,
    Constant as Constant,
    Entry as Entry,
    Guard as Guard,
    Guarded as Guarded,
    Learned as Learned,
    Lookup as Lookup,
    Schedule as Schedule,
    StabilityMap as StabilityMap,
    check_scheduler as check_scheduler,
    list_schedulers as list_schedulers,
    load_scheduler as load_scheduler,
    made_for as made_for,
    read_tuning as read_tuning,
)
from .variables import VARIABLES as VARIABLES
from .variables import SchedulingVariables as SchedulingVariables
from .variables import reference_preview as reference_preview
