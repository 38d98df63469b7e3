"""The kernels that the driving page calls, and those whose addresses its records hold."""

from .units import CONTROLLERS, PLANTS

CALLED = (
    # a run, and what is shown of it
    "run_sizes", "mpc_prepare", "begin_runs", "roll_on",
    # roads
    "path_words", "path_through", "path_parts", "heading_count", "headings_along", "points_at", "road_edges",
    # cars and plants
    "complete_car", "car_flaw", "outline_of", "overhangs", "plant_parameters", "plant_substeps",
    "plant_law", "dead_periods", "steering_delay", "understeer_gradient", "rear_slip_gradient",
    # controllers
    "informed_numbers", "published_numbers", "learner_memory",
    "pure_pursuit_parameters", "stanley_parameters", "lqr_parameters",
    # speed controls
    "resistance", "usable_friction", "first_top_speed", "longitudinal_begin", "begin_friction", "sensor_variances",
    "horizon_cells", "speed_path_words", "write_speed_path",
    # speeds and drives
    "plan_places", "plan_along_road", "plan_constant", "drive_periods", "drive_samples", "drive_start",
    "complete_samples",
)  # fmt: skip
PAGE_MEMBERS = (
    *CONTROLLERS,
    *(plant for plant in PLANTS if plant.startswith("dual_track")),
    "control_planned_speed", "show_period",
)  # fmt: skip
