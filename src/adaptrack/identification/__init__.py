"""Getting to know a car from a log of its driving."""

from adaptrack.identification.drive_identification import identify_drive
from adaptrack.identification.identified_car import DriveIdentification, Estimate, Identification, Validation
from adaptrack.identification.log_identification import identify
from adaptrack.identification.quantities import Prior
from adaptrack.identification.random_cars import CarRanges, RandomCar, random_car
from adaptrack.identification.reading import Reading
from adaptrack.identification.steering_test import SteeringTest

__all__ = [
    "CarRanges", "DriveIdentification", "Estimate", "Identification", "Prior", "RandomCar", "Reading", "SteeringTest",
    "Validation",
    "identify", "identify_drive", "random_car",
]  # fmt: skip
