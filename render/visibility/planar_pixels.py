"""Pixels that see one plane of one material, whose camera rays need no intersection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from .tracer import Tracer, intersect, pixel_rays

__all__ = ["PlanarPixels", "planar_pixels"]

#: What four rays through a pixel's corners meet lies within this of the plane at its centre, mm.
_FLAT_MM = 1e-3


@dataclass(frozen=True, eq=False)
class PlanarPixels:
    """index : (n,) counted along the rows. normal : (n, 3) of the plane, towards the camera. height : (n,) normal . p.
    material : (n,)."""

    index: NDArray[np.int64]
    normal: NDArray[np.float32]
    height: NDArray[np.float32]
    material: NDArray[np.int64]


def planar_pixels(tracer: Tracer, camera: Camera, coverage: NDArray) -> PlanarPixels:
    """Those that see one painted face, flat to the pixel's corners. coverage : (y, x, f) of ``facet_coverage``."""
    whole = np.flatnonzero(coverage.max(axis=-1) == 1)
    if not len(whole):
        return PlanarPixels(whole, np.zeros((0, 3), np.float32), np.zeros(0, np.float32), whole)
    lanes = device_array(mi.UInt32, whole)
    rays = pixel_rays(camera, lanes)
    centre = intersect(tracer, rays(mi.Float(0.5), mi.Float(0.5)), coherent=True)
    height = dr.dot(centre.normal, centre.position)
    flat = centre.reflecting & (centre.material < len(tracer.material_names))
    for u in (0, 1):
        for v in (0, 1):
            corner = intersect(tracer, rays(mi.Float(u), mi.Float(v)), coherent=True)
            off = dr.abs(dr.dot(centre.normal, corner.position) - height)
            flat &= corner.reflecting & (corner.material == centre.material) & (off < _FLAT_MM)
    kept = flat.numpy()
    return PlanarPixels(
        index=whole[kept],
        normal=centre.normal.numpy().T[kept],
        height=height.numpy()[kept],
        material=centre.material.numpy().astype(np.int64)[kept],
    )
