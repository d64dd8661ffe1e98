"""Pixels that show one plane of one material, whose camera rays need no intersection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from .tracer import Tracer, intersect, pixel_rays

__all__ = ["PlanarPixels", "planar_pixels"]

#: Largest distance of the hits of four rays through a pixel's corners from the plane at its centre, mm.
_FLAT_MM = 1e-3


@dataclass(frozen=True, eq=False)
class PlanarPixels:
    """Pixels that show one plane of one material."""

    #: (n,) pixels, counted along the rows, rising.
    index: NDArray[np.int64]
    #: (n, 3) unit normal N of the plane, towards the camera.
    normal: NDArray[np.float32]
    #: (n,) N . p for the points p of the plane, mm.
    height: NDArray[np.float32]
    #: (n,) index of the material.
    material: NDArray[np.int64]


def planar_pixels(tracer: Tracer, camera: Camera, coverage: NDArray) -> PlanarPixels:
    """Pixels that show one painted face, flat to the pixel's corners.

    Parameters
    ----------
    tracer
        The prepared scene.
    camera
        Camera of the image.
    coverage
        (y, x, f) coverage of `facet_coverage`.

    Returns
    -------
    PlanarPixels
        These pixels; lamps are not among them.
    """
    single = np.flatnonzero(coverage.max(axis=-1) == 1)
    if not len(single):
        return PlanarPixels(single, np.zeros((0, 3), np.float32), np.zeros(0, np.float32), single)
    lanes = device_array(mi.UInt32, single)
    rays = pixel_rays(camera, lanes)
    centre = intersect(tracer, rays(mi.Float(0.5), mi.Float(0.5)), coherent=True)
    height = dr.dot(centre.normal, centre.position)
    flat = centre.reflecting & (centre.material < len(tracer.material_names))
    for u in (0, 1):
        for v in (0, 1):
            corner = intersect(tracer, rays(mi.Float(u), mi.Float(v)), coherent=True)
            deviation = dr.abs(dr.dot(centre.normal, corner.position) - height)
            flat &= corner.reflecting & (corner.material == centre.material) & (deviation < _FLAT_MM)
    dr.eval(flat, height, centre.normal, centre.material)  # together: one kernel
    selected = flat.numpy()
    return PlanarPixels(
        index=single[selected],
        normal=np.stack([axis.numpy() for axis in centre.normal], axis=1)[selected],
        height=height.numpy()[selected],
        material=centre.material.numpy().astype(np.int64)[selected],
    )
