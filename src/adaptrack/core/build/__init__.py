"""The builder: kernels become machine code, one library for each processor. The only files that import numba."""
