"""What the package is developed with, beside the benchmarks: not part of what is installed."""
