"""The builder: kernels become C, and a library for each processor."""
