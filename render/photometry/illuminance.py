"""Illuminance of the surfaces of a diffuse box, from the radiosity solution."""

from __future__ import annotations

import numpy as np
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

from ..radiosity import PatchedScene, build_patched_scene, solve_exchange
from ..visibility import RAY_OFFSET_MM
from .observer import tristimulus_weights

__all__ = ["surface_illuminance"]


def surface_illuminance(
    scene: Scene,
    wavelength_nm: NDArray[np.float64],
    max_bounces: int | None = None,
    patch_samples: int = 2048,
    seed: int = 0,
) -> dict[str, float]:
    """Mean illuminance of each surface: pi times the mean radiance that arrives at its patches.

    The mean is over the part of the surface that no other one touches, both lit and in shadow. Light that was reflected
    up to ``max_bounces`` - 1 times before counts, as in a picture.

    Parameters
    ----------
    scene
        Scene of diffuse materials.
    wavelength_nm
        (w,) wavelengths over which illuminance is integrated, nm.
    max_bounces
        Largest number of reflections between lamp and camera; None for no limit.
    patch_samples, seed
        As in ``solve_light``, which shares the traced exchange of light.

    Returns
    -------
    dict
        Illuminance by name of the surface, lx, the lamps' last; NaN for a surface that others cover.

    Raises
    ------
    InputError
        If the scene is not diffuse, or there are fewer than two wavelengths.
    """
    patched = build_patched_scene(scene, patch_samples=patch_samples, seed=seed)
    exchange, patches = patched.exchange, patched.patches
    weights = tristimulus_weights(wavelength_nm)[:, 1]
    radiances = np.array([lamp.radiance.at(wavelength_nm) for lamp in scene.lamps])
    arriving = exchange.direct.astype(float) @ radiances  # (p, w) W m^-2 sr^-1 nm^-1, over the hemisphere
    if max_bounces is None or max_bounces > 1:
        reflectance = scene.reflectances(wavelength_nm)[patches.material]
        before = None if max_bounces is None else max_bounces - 1
        leaving = solve_exchange(exchange, reflectance, arriving, before)
        arriving = arriving + exchange.form_factors @ leaving.astype(np.float32)
    illuminance = np.pi * arriving @ weights
    area = patches.area * exchange.exposed * ~_resting(patched)
    # each of several lamps is one surface here; patches count them together as one
    surface = patches.surface + np.maximum(patches.material - len(patched.tracer.material_names), 0)
    count = len(scene.all_surfaces)
    light, exposed_area = (np.bincount(surface, part, count) for part in (area * illuminance, area))
    with np.errstate(invalid="ignore"):
        means = np.where(exposed_area > 0, light / exposed_area, np.nan)
    return {each.name: float(mean) for each, mean in zip(scene.all_surfaces, means, strict=True)}


def _resting(patched: PatchedScene) -> NDArray[np.bool_]:
    """(p,) whether a patch lies on another surface, as a block's underside does.

    Rays of such a patch begin behind the other surface.
    """
    patches, tracer = patched.patches, patched.tracer
    blind = (patched.exchange.escape > 1 - 1e-6) & ~patched.exchange.direct.any(axis=1)
    resting = np.zeros(len(blind), bool)
    corners, normals = tracer.vertices, tracer.normals
    for index in np.flatnonzero(blind):
        offset = patches.centre[index] - corners
        # inside the triangle's prism: on the same side of all three edges
        edges = np.roll(corners, -1, axis=1) - corners
        inside = np.all(np.einsum("tki,ti->tk", np.cross(edges, offset), normals) >= 0, axis=1)
        height = np.einsum("ti,ti->t", offset[:, 0], normals)
        facing = normals @ patches.normal[index] < -0.99
        resting[index] = np.any(facing & inside & (np.abs(height) < RAY_OFFSET_MM))
    return resting
