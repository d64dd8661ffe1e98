"""Haze: the air scatters, everywhere between camera and back wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.render.haze import mean_radiance
from cboxlab.render.patch_light import PatchLight
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from ._effect import Effect, Parameter

__all__ = ["EFFECT"]

_STEPS_ALONG_RAY = 12
_CELLS = 7


def _apply(light: PatchLight, extinction_per_m: float, albedo: float) -> PatchLight:
    """Attenuation on every way; light scattered once, with the picture's own light in the air; isotropic."""
    if extinction_per_m == 0:
        return light
    sigma = extinction_per_m * 1e-3
    transport = light.transport
    field, patches = transport.light, transport.light.patches
    corners = np.concatenate([s.vertices_mm for s in light.scene.surfaces])
    low, high = corners.min(axis=0), corners.max(axis=0)
    eye = transport.camera.position_mm
    axes = [np.linspace(low[i] + 1, high[i] - 1, _CELLS) for i in range(2)]
    axes.append(np.linspace(min(eye[2], low[2]) + 1, high[2] - 1, 2 * _CELLS))
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    air = mean_radiance(field, light.patch_radiance(), grid.reshape(-1, 3)).reshape(*grid.shape[:3], -1)
    lookup = RegularGridInterpolator(tuple(axes), air, bounds_error=False, fill_value=None)
    inside = air[:, :, axes[2] > low[2]].mean(axis=(0, 1, 2))

    lamp_centre = field.tracer.lamp_triangles.reshape(-1, 3).mean(axis=0)

    def exchange(matrix: NDArray, positions: NDArray, direct: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """The matrix and direct light with attenuation, and the part of the hemisphere that scatters."""
        passed = np.exp(-sigma * _distances(positions, patches.centre)).astype(np.float32)
        kept = matrix * passed
        lost = matrix.sum(axis=1) - kept.sum(axis=1)
        return (
            kept,
            direct * np.exp(-sigma * np.linalg.norm(positions - lamp_centre, axis=1)).astype(np.float32),
            lost,
        )

    form_factors, direct, patch_lost = exchange(
        field.exchange.form_factors, patches.centre, field.exchange.direct
    )
    gather, fragment_direct, fragment_lost = exchange(transport.gather, transport.position, transport.direct)
    hazy = replace(
        transport,
        light=replace(field, exchange=replace(field.exchange, form_factors=form_factors, direct=direct)),
        gather=gather,
        direct=fragment_direct,
    )
    scattered = albedo * inside
    changed = light.change(
        transport=hazy,
        patch_emission=light.patch_emission + light.patch_reflectance * np.outer(patch_lost, scattered),
        fragment_emission=light.fragment_emission
        + light.fragment_reflectance * np.outer(fragment_lost, scattered),
    )
    depth, direction = _depth(light, lamp_centre, high[2])
    arrived = np.exp(-sigma * depth)
    seen = changed.picture()
    added = seen * (arrived - 1)
    for step in range(_STEPS_ALONG_RAY):
        along = (step + 0.5) / _STEPS_ALONG_RAY * depth
        source = lookup(eye + along[..., None] * direction)
        added += np.moveaxis(
            source * (albedo * sigma * np.exp(-sigma * along) * depth / _STEPS_ALONG_RAY)[..., None], -1, 0
        )
    return changed.change(added=changed.added + added)


def _distances(a: NDArray, b: NDArray) -> NDArray[np.float32]:
    """(n, m) mm between two sets of points."""
    a, b = a.astype(np.float32), b.astype(np.float32)
    square = (a**2).sum(1)[:, None] + (b**2).sum(1)[None] - 2 * a @ b.T
    return np.sqrt(np.maximum(square, 0))


def _depth(light: PatchLight, lamp_centre: NDArray, back_mm: float) -> tuple[NDArray, NDArray]:
    """(y, x) mm to what each pixel sees (the back wall's plane where it sees nothing), and directions (y, x, 3)."""
    t, camera = light.transport, light.transport.camera
    rows, columns = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(float)
    direction = camera.directions(columns, rows)
    reach = np.linalg.norm(t.position - camera.position_mm, axis=1)
    flat = np.bincount(t.pixel, t.coverage * reach, minlength=rows.size).reshape(rows.shape)
    lamp = np.maximum(
        t.covered - np.bincount(t.pixel, t.coverage, minlength=rows.size).reshape(rows.shape), 0
    )
    empty = (back_mm - camera.position_mm[2]) / np.maximum(direction[..., 2], 1e-3)
    return flat + lamp * np.linalg.norm(lamp_centre - camera.position_mm) + (1 - t.covered) * empty, direction


EFFECT = Effect(
    id="haze",
    stage="transport",
    summary="The air scatters, isotropically, everywhere between camera and back wall: extinction per metre of way, "
    "albedo of single scattering.",
    parameters=(
        Parameter("extinction_per_m", "m^-1", null=0.0, low=0.0, high=2.0, step=0.01),
        Parameter("albedo", "1", low=0.0, high=1.0, step=0.05, default=0.9),
    ),
    apply=_apply,
    confirm="Photograph a black trap near the camera and one at the back wall: haze makes the far one brighter, "
    "glare in the lens both alike.",
    sources=("single scattering: Chandrasekhar, 'Radiative Transfer', 1950",),
)
