"""One viewer of measured and rendered pictures, in plain JavaScript, for the report, the workbench and notebooks.

Its interface in the browser stands at the head of ``static/viewer.js``.
"""

from .fragment import viewer_fragment, viewer_script, viewer_style
from .payload import changed_data, encoded, picture_data, viewer_data

__all__ = [
    "changed_data",
    "encoded",
    "picture_data",
    "viewer_data",
    "viewer_fragment",
    "viewer_script",
    "viewer_style",
]
