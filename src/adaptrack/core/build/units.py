"""The kernels that FMUs call, beside those of an exported controller."""

UNIT_KERNELS = {
    "CarUnit": ("car_begin", "car_step"),
    "SteeringUnit": ("steering_begin", "steering_step"),
    "LawSteeringUnit": ("law_steering_begin", "law_steering_step"),
    "SpeedSteeringUnit": ("steering_begin", "speed_steering_step"),
    "LawSpeedSteeringUnit": ("law_steering_begin", "law_speed_steering_step"),
}
"""Of each unit of co-simulation (`core.units`) the kernels that begin and step, by the name of its record."""
PLANTS = tuple(
    f"{track}_{tyre}_{member}"
    for track in ("single_track", "dual_track")
    for tyre in ("linear", "magic", "curved")
    for member in ("advance", "observe")
)
"""Members that a car has the address of."""
