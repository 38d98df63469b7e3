"""The numerical core: floats, arrays and records of these in and out, without allocation and without exceptions.

One Python source runs in three ways: from a library that `build` compiles ahead (see `library`), compiled at run time,
or as the Python that it is. `build` compiles them.
"""
