"""Settings of the documentation: `make docs` builds it, and warnings are errors."""

import sys
from importlib.metadata import version as _version
from pathlib import Path as _Path

sys.path.insert(0, str(_Path(__file__).parent / "extensions"))

project = "adaptrack"
author = "The adaptrack contributors"
copyright = "2026, the adaptrack contributors"
version = release = _version("adaptrack")

extensions = ["myst_parser", "mathml", "configuration_keys"]
html_math_renderer = "mathml"
myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]

html_theme = "furo"
html_title = f"adaptrack {release}"
html_static_path = ["static"]
html_css_files = ["pages.css"]
