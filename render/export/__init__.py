"""Export of a scene for other renderers, and import of the renderings that they write."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .neutral import (
        Exported,
        ExportSettings,
        Layout,
        exported_scene,
        exr_pixels,
        npy_pixels,
        raw_pixels,
        read_camera,
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
    "write_export",
]

__getattr__, __dir__ = lazy_names(__name__)
