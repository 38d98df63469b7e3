"""What simulated cars, estimators and controllers share: gravity and air, tyre forces, numbers of a car, axle loads."""
