"""A box for other renderers, and the way back from what they wrote."""

from .camera_file import read_camera, write_camera
from .exported import Exported, ExportSettings, exported_scene
from .formats import FORMATS, as_rendered, read_rendered, write_export

__all__ = [
    "FORMATS",
    "ExportSettings",
    "Exported",
    "as_rendered",
    "exported_scene",
    "read_camera",
    "read_rendered",
    "write_camera",
    "write_export",
]
