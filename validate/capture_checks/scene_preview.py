"""Coarse rendering of a diffuse scene for the checks of a capture.

A pixel of surface s has the radiance rho_s (e + F b) over the lamp's: e is the lamp's direct light with shadows,
F b the light of the patches by the radiosity solution. The radiosity patches are much larger than those of a picture,
because the checks need the light to one or two per cent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.rendering.device import SobolPoints, device_array, dr, mi
from cboxlab.rendering.radiosity import PatchedScene, build_patched_scene, direct_light, patch_of, solve_exchange
from cboxlab.rendering.visibility import intersect, pixel_rays
from cboxlab.scenes import Scene
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

__all__ = ["ScenePreview", "render_preview"]

#: Largest number of rows and columns: sound captures are then located within 0.15 px of a picture of this size.
MOST_PX = 128

#: Largest edge of a radiosity patch over the scene's diagonal: with 1/20 the mean light changes by 0.02 %.
PATCH_EDGE_SHARE = 1 / 7

#: Rays from each patch: the mean light of the published box is within 0.1 %; with 128 it is 0.8 % too low.
PATCH_SAMPLES = 1024

#: Shadow rays of a pixel: the error in a penumbra is at most 6 % of the brightest pixel's direct light.
SHADOW_RAYS = 16


@dataclass(frozen=True, eq=False)
class ScenePreview:
    """Rendering of every ``step``-th row and column of the camera's picture."""

    #: Distance between neighbouring rows and between neighbouring columns, px.
    step: int

    #: (y, x) index into the scene's surfaces; their number for the lamp, -1 for the background and for back sides.
    surface: NDArray[np.int64]

    #: (y, x) True where a lit side of a surface other than the lamp is visible.
    on_surface: NDArray[np.bool_]

    #: (y, x) direct irradiance over pi and over the lamp's radiance, 0 to 1; 0 outside ``on_surface``.
    direct: NDArray[np.float64]

    #: (band, y, x) radiance over the lamp's; 0 outside ``on_surface``.
    radiance: NDArray[np.float64]


def render_preview(scene: Scene, camera: Camera, reflectance: NDArray[np.float64]) -> ScenePreview:
    """Render a scene coarsely: visible surfaces, direct light and interreflection of its lamp.

    Surfaces reflect by Lambert's law, with the mean of a texture and without a medium. The result is repeatable.

    Parameters
    ----------
    scene
        A scene with one lamp.
    camera
        Camera of the picture.
    reflectance
        (material + 1, band) reflectances in the order of ``scene.materials``, the lamp's last, 0 to 1.

    Returns
    -------
    ScenePreview
        At most ``MOST_PX`` rows and columns.
    """
    step = max(1, -(-max(camera.height_px, camera.width_px) // MOST_PX))
    rows, columns = np.mgrid[0 : camera.height_px : step, 0 : camera.width_px : step]
    extent = np.ptp(np.concatenate([surface.vertices_mm for surface in scene.all_surfaces]), axis=0)
    patched = build_patched_scene(
        scene.lambertian, PATCH_EDGE_SHARE * float(np.linalg.norm(extent)), patch_samples=PATCH_SAMPLES
    )
    hits = _trace_pixels(patched, camera, (rows * camera.width_px + columns).ravel())
    of_patch = reflectance[patched.patches.material]
    leaving = solve_exchange(patched.exchange, of_patch)
    arriving = patched.exchange.form_factors @ leaving.astype(np.float32)
    indirect = patched.exchange.slopes.at(arriving, hits.patch, hits.position_mm)
    light = hits.direct[:, None] + np.maximum(indirect, 0.0)
    radiance = np.where(hits.on_surface[:, None], reflectance[hits.material] * light, 0.0)
    shape = rows.shape
    return ScenePreview(
        step,
        hits.surface.reshape(shape),
        hits.on_surface.reshape(shape),
        hits.direct.reshape(shape),
        radiance.T.reshape(-1, *shape),
    )


@dataclass(frozen=True, eq=False)
class _Hits:
    """First hits of n camera rays."""

    #: (n,) index into the scene's surfaces, their number for the lamp, -1 for none.
    surface: NDArray[np.int64]
    #: (n,) True on lit sides of surfaces; the fields below hold 0 elsewhere.
    on_surface: NDArray[np.bool_]
    #: (n,) index of the material.
    material: NDArray[np.int64]
    #: (n,) index of the radiosity patch.
    patch: NDArray[np.int64]
    #: (n, 3) position, mm.
    position_mm: NDArray[np.float64]
    #: (n,) direct irradiance over pi and the lamp's radiance.
    direct: NDArray[np.float64]


def _trace_pixels(patched: PatchedScene, camera: Camera, pixels: NDArray[np.int64]) -> _Hits:
    """First hits of rays through the centres of pixels (n,), counted along the rows."""
    tracer, lamp = patched.tracer, patched.lamps[0]
    lamp_index = len(tracer.scene.surfaces)
    half = mi.Float(0.5)
    hit = intersect(tracer, pixel_rays(camera, device_array(mi.UInt32, pixels))(half, half), coherent=True)
    on_surface = hit.front & (hit.material < len(tracer.material_names))
    patch = patch_of(patched.patches, hit.triangle, hit.uv, on_surface)
    points = SobolPoints(2, SHADOW_RAYS, dr.arange(mi.UInt32, len(pixels)), seed=0)

    def add_shadow_ray(ray: mi.UInt32, total: mi.Float) -> tuple[mi.UInt32, mi.Float]:
        u, v = points.point(ray, 0), points.point(ray, 1)
        return ray + 1, total + direct_light(tracer, lamp, hit.position, hit.normal, u, v, on_surface)

    count = dr.opaque(mi.UInt32, SHADOW_RAYS)
    start = (dr.zeros(mi.UInt32, len(pixels)), dr.zeros(mi.Float, len(pixels)))
    _, total = dr.while_loop(start, lambda ray, _: ray < count, add_shadow_ray)
    dr.eval(total, hit.triangle, hit.position, hit.front, hit.material, on_surface, patch)
    visible, on_paint = np.array(hit.front), np.array(on_surface)
    triangle = np.where(visible, np.array(hit.triangle), 0).astype(np.int64)
    return _Hits(
        np.where(visible, np.minimum(tracer.surface[triangle], lamp_index), -1),
        on_paint,
        np.where(on_paint, np.array(hit.material), 0).astype(np.int64),
        np.where(on_paint, np.array(patch), 0).astype(np.int64),
        np.where(on_paint[:, None], np.array(hit.position).T, 0.0),
        np.where(on_paint, np.array(total) / SHADOW_RAYS, 0.0),
    )
