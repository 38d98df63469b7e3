"""Kernels of the peers, built into the library like the core's: of ours they import `core.public` alone."""
