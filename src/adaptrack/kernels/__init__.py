"""The numeric kernels: the only room that imports numba. Floats and arrays in, floats and arrays out.

A kernel is compiled when it is first called, apart from all others: one control step (`step`) asks for less than whole
runs (`rollout`), and those for less than a swarm (`tune`). What is compiled is kept on disk, see `abi.cache_directory`.
"""
