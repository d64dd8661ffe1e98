"""Export of a scene for other renderers, and import of the renderings that they write."""

from .neutral import (
    Exported,
    ExportSettings,
    Layout,
    exported_scene,
    exr_pixels,
    npy_pixels,
    raw_pixels,
    read_camera,
    write_camera,
)
from .renderers import Renderer, renderer_catalogue, renderer_of
from .results import as_rendered, read_rendered, write_export

__all__ = [
    "ExportSettings",
    "Exported",
    "Layout",
    "Renderer",
    "as_rendered",
    "exported_scene",
    "exr_pixels",
    "npy_pixels",
    "raw_pixels",
    "read_camera",
    "read_rendered",
    "renderer_catalogue",
    "renderer_of",
    "write_camera",
    "write_export",
]
