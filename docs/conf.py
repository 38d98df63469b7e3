"""Settings of the documentation: `make docs` builds it, and warnings are errors."""

import sys
from importlib.metadata import version as _version
from pathlib import Path as _Path

sys.path.insert(0, str(_Path(__file__).parent / "extensions"))

project = "adaptrack"
author = "The adaptrack contributors"
copyright = "2026, the adaptrack contributors"
version = release = _version("adaptrack")

extensions = ["myst_parser", "mathml", "docstrings", "checked_types", "configuration_keys"]
html_math_renderer = "mathml"
myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_heading_anchors = 3
default_role = "py:obj"  # of docstrings: a public name links to its place, anything else is code
autodoc_default_options = {
    "members": True,
    "inherited-members": ", ".join(  # but for those of
        [
            "BaseModel",
            "BaseException",
            "BaseEstimator",
            "RegressorMixin",
            "MultiOutputMixin",
            "tuple",
            "int",
            "str",
            "object",
        ]
    ),
}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_type_aliases = {
    name: name
    for name in (
        "Array",
        "ArrayLike",
        "PerceptionSource",
        "PolicyArgument",
        "ProgressCall",
        "Segment",
        "SignalLike",
        "Variables",
    )
}
maximum_signature_line_length = 88
python_use_unqualified_type_names = True
exclude_patterns = ["_build"]

html_theme = "furo"
html_title = f"adaptrack {release}"
html_static_path = ["static"]
html_css_files = ["pages.css"]


def write_page(app, exception):
    """Write the page on which one drives beside the built pages; docs/page.md and docs/index.md link to it."""
    if exception is None and app.builder.name == "html":
        from adaptrack.export.page_file import write_page

        write_page(_Path(app.outdir) / "drive.html")


def setup(app):
    """What Sphinx calls."""
    app.connect("build-finished", write_page)
