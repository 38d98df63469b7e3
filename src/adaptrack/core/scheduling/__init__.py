"""Schedules: from scheduling variables to the tuning of a controller."""
