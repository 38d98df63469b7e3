"""Settings of the documentation: `make docs` builds it, and warnings are errors."""

from importlib.metadata import version as _version

project = "adaptrack"
author = "The adaptrack contributors"
copyright = "2026, the adaptrack contributors"
version = release = _version("adaptrack")

extensions = ["myst_parser", "sphinx.ext.mathjax"]
myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]

html_theme = "furo"
html_title = f"adaptrack {release}"
