"""A controller leaves Python: its constants, and the C sources around the kernels."""
