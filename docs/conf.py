"""The manual: python -m sphinx -W docs build/manual (pip install 'cboxlab[docs]')."""

import importlib.metadata
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import generated_pages

project = "cboxlab"
author = "the authors of cboxlab"
release = importlib.metadata.version("cboxlab")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
suppress_warnings = ["myst.xref_missing_file"]
html_theme = "furo"
html_title = f"cboxlab {release}"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
napoleon_google_docstring = False
napoleon_use_rtype = False
#: Names in signatures that no page documents by name: classes behind the public functions, and those of libraries.
nitpick_ignore_regex = [
    ("py:class", r"(pathlib\.)?Path|Figure|(xarray|numpy|collections)\..+"),
    ("py:class", r"cboxlab\.(utils|calibration|rendering|scenes|validation)\..+"),
    ("py:exc", "Cancelled"),
]


def setup(app):
    """Text that the program itself knows stands in the pages as <!-- generated: NAME -->."""
    app.connect("source-read", generated_pages.fill_in)
