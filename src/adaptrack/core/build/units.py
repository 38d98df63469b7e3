"""The kernels that other programs call: FMUs, in addition to those of an exported controller, and the driving page."""

UNIT_KERNELS = {
    "CarUnit": ("car_begin", "car_step"),
    "SteeringUnit": ("steering_begin", "steering_step"),
    "FollowerUnit": ("follower_begin", "follower_step"),
}
"""Of each unit of co-simulation (`core.units`) the kernels that begin and step, by the name of its record."""
CONTROLLERS = (
    "begin_mpc", "request_of_mpc", "step_mpc", "discretise_single_track", "discretise_path", "kalman",
    "begin_law", "request_of_law", "step_law", "stanley", "pure_pursuit", "lqr",
)  # fmt: skip
"""Members that a controller has the address of."""
TRACKERS = (*CONTROLLERS, "learn_car", "believe", "longitudinal_step", "narrow_tracked_friction")
"""Members that a tracker has the address of."""
PLANTS = tuple(
    f"{track}_{tyre}_{member}"
    for track in ("single_track", "dual_track")
    for tyre in ("linear", "magic", "curved")
    for member in ("advance", "observe")
)
"""Members that a car has the address of."""
PAGE_CALLS = (
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
    # a planner, and the tracker that follows it
    "check_settings", "tracker_engage", "tracker_apply", "tracker_step", "tracker_predict", "watch_planner",
    "trajectory_words", "take_trajectory", "begin_trajectory", "longitudinal_follow",
    "project_all", "planned_speeds", "plan_motion", "elementary_values", "counted_normal",
)  # fmt: skip
"""The kernels that the driving page calls by name."""
PAGE_MEMBERS = (
    *CONTROLLERS,
    *(plant for plant in PLANTS if plant.startswith("dual_track")),
    "control_planned_speed", "show_period", "longitudinal_step", "narrow_tracked_friction",
)  # fmt: skip
"""Members whose addresses the records of the page hold."""
PAGE_KERNELS = (*PAGE_CALLS, *PAGE_MEMBERS)
