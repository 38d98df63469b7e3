"""What every room needs: errors, files, registries, limits, checked arguments, progress."""
