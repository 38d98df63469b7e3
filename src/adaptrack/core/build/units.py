"""The kernels that FMUs call, beside those of an exported controller."""

UNIT_KERNELS = {
    "CarUnit": ("car_begin", "car_step"),
    "SteeringUnit": ("steering_begin", "steering_step"),
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
