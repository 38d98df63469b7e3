"""Foundation of all subpackages: errors, files, registries, limits, argument checks, progress reports."""
