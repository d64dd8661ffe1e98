"""Spectral cubes and raw frames on disk."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .colour_pictures import COLOUR_SPACES, picture_of_colours, primaries_matrix, stated_space
    from .cube_camera import camera_attribute, camera_of_attribute
    from .cube_checks import RADIANCE_UNIT, negative_pixels, require_light, require_numbers, require_stored
    from .cube_files import READABLE, WRITABLE, files_of, open_cube, read_cube, read_picture, write_cube
    from .cube_strips import strip_cameras, write_strips
    from .declared import (
        AS_STATED,
        DECLARABLE,
        NOTES,
        UNIT_AS_STORED,
        Declared,
        DeclaredPair,
        declared_for,
        require_used,
        stated_in,
        with_declarations,
        with_notes,
    )
    from .dng import write_dng
    from .exr_channels import ExrChannels, read_layers, require_exr_size, write_channels
    from .headers import Window, common_pixels, layers_of, listed, window_in_file, window_of, with_window
    from .netcdf import open_netcdf
    from .previews import cube_to_srgb, raw_to_srgb, scene_white, xyz_weights
    from .radiance_hdr import radiance_as_stored
    from .raw_files import write_raw
    from .spectral_exr import spectral_channels

__all__ = [
    "AS_STATED",
    "COLOUR_SPACES",
    "DECLARABLE",
    "NOTES",
    "RADIANCE_UNIT",
    "READABLE",
    "UNIT_AS_STORED",
    "WRITABLE",
    "Declared",
    "DeclaredPair",
    "ExrChannels",
    "Window",
    "camera_attribute",
    "camera_of_attribute",
    "common_pixels",
    "cube_to_srgb",
    "declared_for",
    "files_of",
    "layers_of",
    "listed",
    "negative_pixels",
    "open_cube",
    "open_netcdf",
    "picture_of_colours",
    "primaries_matrix",
    "radiance_as_stored",
    "raw_to_srgb",
    "read_cube",
    "read_layers",
    "read_picture",
    "require_exr_size",
    "require_light",
    "require_numbers",
    "require_stored",
    "require_used",
    "scene_white",
    "spectral_channels",
    "stated_in",
    "stated_space",
    "strip_cameras",
    "window_in_file",
    "window_of",
    "with_declarations",
    "with_notes",
    "with_window",
    "write_channels",
    "write_cube",
    "write_dng",
    "write_raw",
    "write_strips",
    "xyz_weights",
]

__getattr__, __dir__ = lazy_names(__name__)
