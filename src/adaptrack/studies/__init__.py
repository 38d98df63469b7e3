"""Whole studies: comparison of controllers, shadow mode, and the constant of a car."""
