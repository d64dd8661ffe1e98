"""Renderer-neutral part of an export: scene, film and rays, and their files."""

from .camera_file import camera_entry, read_camera
from .exported import (
    Exported,
    ExportedLamp,
    ExportSettings,
    Layout,
    channel_groups,
    exported_scene,
    pixel_means,
    subpixel_rays,
)
from .raw_pixels import exr_pixels, exr_radiance, npy_pixels, raw_pixels
from .scene_files import has_export, mesh_path, rays_path, read_layout, read_surfaces, read_warp, write_neutral

__all__ = [
    "ExportSettings",
    "Exported",
    "ExportedLamp",
    "Layout",
    "camera_entry",
    "channel_groups",
    "exported_scene",
    "exr_pixels",
    "exr_radiance",
    "has_export",
    "mesh_path",
    "npy_pixels",
    "pixel_means",
    "raw_pixels",
    "rays_path",
    "read_camera",
    "read_layout",
    "read_surfaces",
    "read_warp",
    "subpixel_rays",
    "write_neutral",
]
