"""The picture of a slightly moved camera, without rendering again.

In a pixel I = Sum_f c_f L_f, with c_f the share covered by flat face f and L_f the signal of that face. A motion of
the camera changes c_f, which is found by camera rays (always with the same random numbers), and moves the point seen
on each face, for which L_f is interpolated in the picture of the first camera. The difference between the two cameras
is added to the rendered picture. Rays are traced only near borders of faces.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.scenes.camera import PARAMETER_NAMES, Camera
from cboxlab.scenes.frozen import OwnMappings
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from ..image import RenderedImage
from ..visibility import Tracer, border_pixels, pixel_coverage

__all__ = ["Warp", "build_warp", "pixels_per_unit", "warp_change"]

# The coverage changes in steps of 1 / samples; with 64 samples these steps exceed a camera's noise.
_COVERAGE_SAMPLES = 512

# Smallest coverage by a face of pixels that are used for the face's signal.
_MOST = 0.5


@dataclass(frozen=True, eq=False)
class Warp(OwnMappings):
    """A picture decomposed by faces.

    coverage : (y, x, f) of the first camera. border : (n,) pixels, counted along the rows, in which another
    camera's coverage may differ. layers : for each face its signals (band, y, x), extrapolated beyond its border.
    base : (band, y, x) the picture reconstructed from the layers.
    """

    tracer: Tracer
    camera: Camera
    coverage: NDArray[np.float32]
    border: NDArray[np.int64]
    layers: Mapping[int, NDArray[np.float64]]
    base: NDArray[np.float64]


def build_warp(tracer: Tracer, camera: Camera, image: RenderedImage, signal: NDArray[np.float64]) -> Warp:
    """Decompose signals (band, y, x), rendered through ``camera``, by faces.

    The layer of a face has the signals of the pixels that see only this face, extrapolated to the others. In pixels
    that see several faces, the difference to the rendered signal is then assigned to the face that covers most of the
    pixel, which keeps shadows along borders. Not in pixels that see the lamp, where a small error of the lamp's
    coverage would dominate.
    """
    border = border_pixels(image.coverage)
    coverage = _coverage(tracer, camera, image.coverage, border)
    faces = [f for f in range(coverage.shape[-1]) if coverage[..., f].any()]
    parts = {f: coverage[..., f] for f in faces}
    alone = {f: part == part.max() for f, part in parts.items()}
    layers = {f: _continued(signal, alone[f]) for f in faces}
    lacking = signal - sum(parts[f] * layers[f] for f in faces)
    for f in faces:
        most = (parts[f] >= _MOST) & ~image.sees_lamp
        own = layers[f] + lacking / np.where(most, parts[f], 1.0)
        layers[f] = _continued(np.where(alone[f], signal, own), alone[f] | most)
    still = Warp(tracer, camera, coverage, border, layers, np.zeros_like(signal))
    return replace(still, base=warp_change(still, camera))


def warp_change(warp: Warp, camera: Camera) -> NDArray[np.float64]:
    """Change (band, y, x) of the signals if ``camera`` replaces the camera of the warp.

    Valid for motions up to about a pixel; surfaces that only the new camera sees are not known.
    """
    coverage = _coverage(warp.tracer, camera, warp.coverage, warp.border)
    result = np.zeros_like(warp.base)
    for face, layer in warp.layers.items():
        where = coverage[..., face] > 0
        rows, columns = _seen_at(warp.tracer, face, warp.camera, camera, where)
        result[:, where] += coverage[..., face][where] * _interpolated(layer, rows, columns)
    return result - warp.base


def _coverage(tracer: Tracer, camera: Camera, elsewhere: NDArray, border: NDArray) -> NDArray[np.float32]:
    """(y, x, f) coverage seen by ``camera`` in the pixels ``border``, and as given in ``elsewhere`` in all others."""
    coverage = elsewhere.copy()
    rows, columns = np.divmod(border, camera.width_px)
    coverage[rows, columns] = pixel_coverage(tracer, camera, border, _COVERAGE_SAMPLES)
    return coverage


def _interpolated(layer: NDArray, rows: NDArray, columns: NDArray) -> NDArray[np.float64]:
    """(band, n) values of (band, y, x), interpolated bilinearly at positions that are clipped to the picture."""
    height, width = layer.shape[1:]
    row, column = np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)
    top, left = np.minimum(row.astype(int), height - 2), np.minimum(column.astype(int), width - 2)
    down, right = row - top, column - left
    first = top * width + left
    flat = layer.reshape(len(layer), -1)
    upper = (1 - right) * flat[:, first] + right * flat[:, first + 1]
    lower = (1 - right) * flat[:, first + width] + right * flat[:, first + width + 1]
    return (1 - down) * upper + down * lower


def _continued(signal: NDArray, own: NDArray) -> NDArray[np.float64]:
    """Signals (band, y, x), with those of the nearest pixel of ``own`` (y, x) in all other pixels."""
    rows, columns = distance_transform_edt(~own, return_distances=False, return_indices=True)
    return signal[:, rows, columns]


def _seen_at(
    tracer: Tracer, face: int, seen_by: Camera, camera: Camera, where: NDArray
) -> tuple[NDArray, NDArray]:
    """Rows and columns in the picture of ``seen_by`` of the points of a face that ``camera`` sees in ``where``."""
    triangle = int(np.argmax(tracer.facet == face))
    corner, normal = tracer.vertices[triangle, 0], tracer.normals[triangle]
    rows, columns = (index.astype(float) for index in np.nonzero(where))
    direction = camera.directions(columns, rows)
    slope = direction @ normal
    with np.errstate(divide="ignore", invalid="ignore"):
        points = camera.position_mm + (((corner - camera.position_mm) @ normal) / slope)[:, None] * direction
        u, v = seen_by.project(points).T
    # If the central ray misses a face that only touches the pixel, use the pixel itself.
    lost = ~(np.hypot(u - columns, v - rows) < 2.0)
    return np.where(lost, rows, v), np.where(lost, columns, u)


def pixels_per_unit(tracer: Tracer, camera: Camera) -> NDArray[np.float64]:
    """(10,) rms motion, px, of the scene's corners inside the image, per unit of each camera parameter."""
    points = tracer.vertices.reshape(-1, 3)
    image = camera.project(points)
    inside = np.all((image > -0.5) & (image < [camera.width_px, camera.height_px]), axis=1)
    step = 1e-4
    motion = [
        camera.with_parameters(camera.parameters + step * axis).project(points) - image
        for axis in np.eye(len(PARAMETER_NAMES))
    ]
    return np.array([np.sqrt(np.mean(np.sum(m[inside] ** 2, axis=1))) for m in motion]) / step
