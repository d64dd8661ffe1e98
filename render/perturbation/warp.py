"""The picture of a slightly moved camera, without rendering again.

In a pixel I = Sum_f c_f L_f, with c_f the share covered by flat face f and L_f the signal of that face. A motion of
the camera changes c_f, which is found by camera rays (always with the same random numbers), and moves the point seen
on each face, for which L_f is interpolated in the picture of the first camera. The difference between the two cameras
is added to the rendered picture. Rays are traced only near borders of faces.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from cboxlab.scenes.camera import PARAMETER_NAMES, Camera
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array

from ..image import RenderedImage
from ..visibility import Tracer, border_pixels, pixel_coverage

__all__ = ["Warp", "build_warp", "pixels_per_unit", "warp_change", "warp_changes"]

# The coverage changes in steps of 1 / samples; with 64 samples these steps exceed a camera's noise.
_COVERAGE_SAMPLES = 512

# Pixels per step, which limits memory.
_PIXELS_PER_STEP = 2**16

# Smallest coverage by a face of pixels that are used for the face's signal.
_MOST = 0.5


@dataclass(frozen=True, eq=False)
class Warp:
    """A picture decomposed by faces.

    coverage : (y, x, f) of the first camera. border : (n,) pixels, counted along the rows, in which another
    camera's coverage may differ. faces : (k,) those in sight. layers : (k, y, x, band) their signals, extrapolated
    beyond each face's border.
    base : (band, y, x) the picture reconstructed from the layers.
    """

    tracer: Tracer
    camera: Camera
    coverage: NDArray[np.float32]
    border: NDArray[np.int64]
    faces: NDArray[np.int64]
    layers: NDArray[np.float64]
    base: NDArray[np.float64]

    @cached_property
    def inside(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(m,) pixels beyond the border that see a face, and its index in ``faces``."""
        seen = self.coverage.reshape(-1, self.coverage.shape[-1])[:, self.faces] > 0
        seen[self.border] = False
        pixel, face = np.nonzero(seen)
        return pixel, face


def build_warp(tracer: Tracer, camera: Camera, image: RenderedImage, signal: NDArray[np.float64]) -> Warp:
    """Decompose signals (band, y, x), rendered through ``camera``, by faces.

    The layer of a face has the signals of the pixels that see only this face, extrapolated to the others. In pixels
    that see several faces, the difference to the rendered signal is then assigned to the face that covers most of the
    pixel, which keeps shadows along borders. Not in pixels that see the lamp, where a small error of the lamp's
    coverage would dominate.
    """
    border = border_pixels(image.coverage)
    coverage = image.coverage.copy()
    coverage.reshape(-1, coverage.shape[-1])[border] = pixel_coverage(
        tracer, [camera], border, _COVERAGE_SAMPLES
    )[0]
    faces = np.flatnonzero(coverage.any(axis=(0, 1)))
    parts = np.moveaxis(coverage[..., faces], -1, 0)
    layers = np.empty((*parts.shape, len(signal)))
    alone = parts == parts.max(axis=(1, 2), keepdims=True)
    lacking = np.moveaxis(signal, 0, -1).copy()
    for layer, part, own in zip(layers, parts, alone, strict=True):
        layer[:] = _continued(np.moveaxis(signal, 0, -1), own)
        lacking -= part[..., None] * layer
    for layer, part, own in zip(layers, parts, alone, strict=True):
        most = (part >= _MOST) & ~image.sees_lamp
        own_signal = layer + lacking / np.where(most, part, 1.0)[..., None]
        layer[:] = _continued(np.where(own[..., None], np.moveaxis(signal, 0, -1), own_signal), own | most)
    still = Warp(tracer, camera, coverage, border, faces, layers, np.zeros_like(signal))
    return replace(still, base=warp_change(still, camera))


def warp_change(warp: Warp, camera: Camera) -> NDArray[np.float64]:
    """Change (band, y, x) of the signals if ``camera`` replaces the camera of the warp.

    Valid for motions up to about a pixel; surfaces that only the new camera sees are not known.
    """
    return _change(warp, camera, _coverage(warp, [camera])[0])


def warp_changes(warp: Warp, cameras: Sequence[Camera]) -> Iterator[NDArray[np.float64]]:
    """``warp_change`` of each of the cameras, which is faster than one by one."""
    for camera, coverage in zip(cameras, _coverage(warp, cameras), strict=True):
        yield _change(warp, camera, coverage)


def _change(warp: Warp, camera: Camera, coverage: NDArray[np.float32]) -> NDArray[np.float64]:
    """``warp_change``. coverage : (n, k) of ``camera``, see ``_coverage``."""
    result = np.zeros((warp.base[0].size, len(warp.base)))
    inside, own_face = warp.inside
    for start in range(0, len(inside), _PIXELS_PER_STEP):
        part = slice(start, start + _PIXELS_PER_STEP)
        result[inside[part]] = _interpolated(warp, camera, inside[part], own_face[part])
    border, face = np.nonzero(coverage)
    if len(border):
        pixel, first = np.unique(border, return_index=True)
        shares = coverage[border, face, None] * _interpolated(warp, camera, warp.border[border], face)
        result[warp.border[pixel]] = np.add.reduceat(shares, first)
    return result.T.reshape(warp.base.shape) - warp.base


def _coverage(warp: Warp, cameras: Sequence[Camera]) -> NDArray[np.float32]:
    """(c, n, k) coverage of the pixels ``border`` by the faces in sight, seen by each camera."""
    return pixel_coverage(warp.tracer, cameras, warp.border, _COVERAGE_SAMPLES)[..., warp.faces]


def _interpolated(warp: Warp, camera: Camera, pixel: NDArray, face: NDArray) -> NDArray[np.float64]:
    """(n, band) values of the layers ``face`` where ``camera`` sees them in some pixels, interpolated at positions
    clipped to the picture."""
    height, width = warp.layers.shape[1:3]
    rows, columns = _seen_at(warp, camera, face, *np.divmod(pixel, width))
    row, row_weights = _cubic(rows, height)
    column, column_weights = _cubic(columns, width)
    places = ((face[:, None] * height + row)[..., None] * width + column[:, None]).reshape(len(face), -1)
    weights = row_weights[..., None] * column_weights[:, None]
    flat = warp.layers.reshape(-1, warp.layers.shape[-1])
    ends = np.arange(0, places.size + 1, places.shape[1])
    return csr_array((weights.ravel(), places.ravel(), ends), shape=(len(places), len(flat))) @ flat


def _cubic(position: NDArray[np.float64], size: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """(n, 4) neighbours of positions (n,) along an axis and their weights, after Keys, IEEE Trans. ASSP 29, 1981.

    The interpolated value has a slope at the pixels themselves; with straight lines between them a motion of 0.05 px
    was wrong by 0.16 of chi2 per sample (128 x 128 pixels).
    """
    position = np.clip(position, 0, size - 1)
    before = position.astype(int)
    t = position - before
    places = np.clip(before[:, None] + [-1, 0, 1, 2], 0, size - 1)
    rise = (
        ((2 - t) * t - 1) * t / 2,
        ((3 * t - 5) * t * t + 2) / 2,
        ((4 - 3 * t) * t + 1) * t / 2,
        (t - 1) * t * t / 2,
    )
    return places, np.stack(rise, axis=1)


def _continued(signal: NDArray, own: NDArray) -> NDArray[np.float64]:
    """Signals (y, x, band), with those of the nearest pixel of ``own`` (y, x) in all other pixels."""
    rows, columns = distance_transform_edt(~own, return_distances=False, return_indices=True)
    return signal[rows, columns]


def _seen_at(
    warp: Warp, camera: Camera, face: NDArray, rows: NDArray, columns: NDArray
) -> tuple[NDArray, NDArray]:
    """Rows and columns (n,) in the warp's picture of what ``camera`` sees of a face in each of some pixels."""
    triangle = np.array([np.argmax(warp.tracer.facet == f) for f in warp.faces])
    corner, normal = warp.tracer.vertices[triangle, 0], warp.tracer.normals[triangle]
    heights = np.sum((corner - camera.position_mm) * normal, axis=1)
    direction = camera.directions(columns, rows)
    slope = np.einsum("ni,ni->n", direction, normal[face])
    with np.errstate(divide="ignore", invalid="ignore"):
        points = camera.position_mm + (heights[face] / slope)[:, None] * direction
        u, v = warp.camera.project(points).T
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
