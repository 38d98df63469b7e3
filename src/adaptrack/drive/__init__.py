"""Driving: the world, one run, a batch of runs, what they record and what is measured of them."""
