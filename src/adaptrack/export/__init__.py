"""A controller leaves Python: its constants as a block of bytes, and the C sources around the compiled kernels."""
