"""Schedules learned on the closed loop."""
