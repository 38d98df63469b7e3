"""Identification of a car from a log: steering and tyres, drive and brakes."""
