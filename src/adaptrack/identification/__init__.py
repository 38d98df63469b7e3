"""Getting to know a car from a log of its driving."""

from adaptrack.identification.identified_car import Estimate, Identification, Validation
from adaptrack.identification.log_identification import identify
from adaptrack.identification.quantities import Prior
from adaptrack.identification.random_cars import CarRanges, RandomCar, random_car
from adaptrack.identification.reading import Reading

__all__ = [
    "CarRanges", "Estimate", "Identification", "Prior", "RandomCar", "Reading", "Validation", "identify", "random_car",
]  # fmt: skip
