"""Viewer of measured and rendered pictures, for the report, the workbench and notebooks.

It is plain JavaScript. Its interface in the browser is documented at the head of ``static/viewer.js``.
"""

from .fragment import viewer_fragment, viewer_part, viewer_script, viewer_style
from .payload import encoded, flip_data, picture_data, viewer_data

__all__ = [
    "encoded",
    "flip_data",
    "picture_data",
    "viewer_data",
    "viewer_fragment",
    "viewer_part",
    "viewer_script",
    "viewer_style",
]
