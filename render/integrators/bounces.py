"""An image split by the number of reflections of its light."""

from __future__ import annotations

import numpy as np
import xarray as xr
from cboxlab.utils.progress import NO_PROGRESS, Progress

from ..image import RenderJob
from ..visibility import build_tracer, facet_coverage
from .path_tracer import trace_paths

__all__ = ["render_bounces"]


def render_bounces(
    job: RenderJob,
    bounces: int = 4,
    progress: Progress = NO_PROGRESS,
) -> xr.DataArray:
    """Radiance of a diffuse scene by path tracing, split by the number of reflections.

    The parts share their paths, so they add up to the path tracer's image.

    Parameters
    ----------
    job
        The image to render.
    bounces
        Largest number of reflections with a part for itself.
    progress
        Receives the completed share after each kernel call.

    Returns
    -------
    DataArray
        (batch, part, y, x, wavelength) radiance, W m^-2 sr^-1 nm^-1. Part "0" is the visible lamp, "1" to `bounces` is
        light reflected that often, "more" is the rest. The coordinate ``surface`` (y, x) names the surface that covers
        most of a pixel; it is empty where less than half is covered.

    Raises
    ------
    InputError
        For a scene that is not diffuse.
    """
    scene, wavelengths = job.scene, job.wavelength_nm
    scene.require_diffuse()
    tracer = build_tracer(scene)
    sums = trace_paths(tracer, job, progress, split=bounces)
    count = len(wavelengths)
    lamps = len(scene.lamps)
    parts = sums[..., lamps:].reshape(*sums.shape[:3], 1 + bounces, count)
    rest = parts[..., :1, :] - parts[..., 1:, :].sum(axis=-2, keepdims=True)
    emitted = (sums[..., :lamps] @ scene.lamp_shares(wavelengths))[..., None, :]
    values = np.concatenate([emitted, parts[..., 1:, :], rest], axis=-2) * scene.lamp_radiance(wavelengths)
    names = np.array([s.name for s in scene.surfaces] + [scene.lamp.surface.name, ""])
    coverage = facet_coverage(tracer, job.camera)
    surface_index = np.where(coverage.sum(axis=-1) < 0.5, -1, tracer.facet_surface[coverage.argmax(axis=-1)])
    return xr.DataArray(
        np.moveaxis(values, 3, 1).astype(np.float32),
        dims=("batch", "part", "y", "x", "wavelength"),
        coords={
            "part": [*map(str, range(1 + bounces)), "more"],
            "wavelength": ("wavelength", wavelengths, {"units": "nm"}),
            "surface": (("y", "x"), names[surface_index]),
        },
        attrs={"units": "W m^-2 sr^-1 nm^-1"},
    )
