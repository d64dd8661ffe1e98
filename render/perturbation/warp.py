"""The picture of a slightly moved camera, without rendering again.

In a pixel I = Sum_f c_f L_f, with c_f the share covered by flat face f and L_f the signal of that face. A motion of
the camera changes c_f near borders of faces. It also moves the point seen on each face, for which L_f is interpolated
in the picture of the first camera. The difference between the two cameras is added to the rendered picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from cboxlab.scenes.camera import PARAMETER_NAMES, Camera
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import checkpoint
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array

from ..image import RenderedImage
from ..visibility import Tracer, border_pixels, pixel_coverage

__all__ = ["Warp", "build_warp", "pixels_per_unit", "warp_change", "warp_derivatives"]

#: Rays of a pixel where the coverage is not known exactly. It then changes in steps of 1 / samples; with 64 samples
#: these steps exceed a camera's noise.
_COVERAGE_SAMPLES = 512

#: Pixels per step, which limits memory.
_PIXELS_PER_STEP = 2**16

#: Largest distance between what a camera sees of a face and the same pixel in the warp's picture, px.
_LOST_PX = 2.0

#: Part of a step over which the motion of points is taken for straight.
_SMALL = 1e-3

#: Weights of four neighbours, by powers of the place between the middle ones.
_KEYS = np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]) / 2

#: Smallest coverage by a face of pixels that are used for the face's signal.
_MIN_COVERAGE = 0.5


@dataclass(frozen=True, eq=False)
class Warp:
    """A picture decomposed by flat faces."""

    #: Geometry of the scene.
    tracer: Tracer
    #: The first camera.
    camera: Camera
    #: (y, x, f) shares of each pixel that faces cover, through the first camera.
    coverage: NDArray[np.float32]
    #: (n,) pixels, counted along the rows, in which another camera's coverage may differ.
    border: NDArray[np.int64]
    #: (k,) faces in sight.
    faces: NDArray[np.int64]
    #: (k, y, x, band) signals of the faces in sight, extrapolated beyond each face's border.
    layers: NDArray[np.float64]
    #: (band, y, x) picture reconstructed from the layers.
    base: NDArray[np.float64]

    @cached_property
    def inside(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(m,) pixels beyond the border that see a face, and its index in ``faces``."""
        covered = self.coverage.reshape(-1, self.coverage.shape[-1])[:, self.faces] > 0
        covered[self.border] = False
        pixel, face = np.nonzero(covered)
        return pixel, face


def build_warp(tracer: Tracer, camera: Camera, image: RenderedImage, signal: NDArray[np.float64]) -> Warp:
    """Decomposition of rendered signals by faces.

    The layer of a face has the signals of the pixels that see only this face, extrapolated to the others. In pixels
    that see several faces, the difference to the rendered signal is then assigned to the face that covers most of the
    pixel, which keeps shadows along borders. Not in pixels that see the lamp, where a small error of the lamp's
    coverage would dominate.

    Parameters
    ----------
    tracer
        Geometry of the scene.
    camera
        Camera of the picture.
    image
        Rendered image, for its coverages.
    signal
        (band, y, x) signals of the image.

    Returns
    -------
    Warp
        The picture by faces.
    """
    border = border_pixels(image.coverage)
    coverage = image.coverage.copy()
    coverage.reshape(-1, coverage.shape[-1])[border] = pixel_coverage(tracer, [camera], border, _COVERAGE_SAMPLES)[0]
    faces = np.flatnonzero(coverage.any(axis=(0, 1)))
    parts = np.moveaxis(coverage[..., faces], -1, 0)
    layers = np.empty((*parts.shape, len(signal)))
    alone = parts == parts.max(axis=(1, 2), keepdims=True)
    lacking = np.moveaxis(signal, 0, -1).copy()
    for layer, part, single in zip(layers, parts, alone, strict=True):
        checkpoint()
        layer[:] = _continued(np.moveaxis(signal, 0, -1), single)
        lacking -= part[..., None] * layer
    for layer, part, single in zip(layers, parts, alone, strict=True):
        checkpoint()
        most = (part >= _MIN_COVERAGE) & ~image.sees_lamp
        face_signal = layer + lacking / np.where(most, part, 1.0)[..., None]
        layer[:] = _continued(np.where(single[..., None], np.moveaxis(signal, 0, -1), face_signal), single | most)
    still = Warp(tracer, camera, coverage, border, faces, layers, np.zeros_like(signal))
    return replace(still, base=_change(still, camera, coverage.reshape(-1, coverage.shape[-1])[border][:, faces]))


def warp_change(warp: Warp, camera: Camera) -> NDArray[np.float64]:
    """Change of the signals if another camera replaces the camera of the warp.

    Valid for motions up to about a pixel; surfaces that only the new camera sees are not known.

    Parameters
    ----------
    warp
        The picture by faces.
    camera
        The other camera.

    Returns
    -------
    NDArray
        (band, y, x) change.
    """
    if camera is warp.camera:
        return np.zeros_like(warp.base)
    return _change(warp, camera, _coverage(warp, [camera])[0])


def warp_derivatives(warp: Warp, camera: Camera, steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Derivatives of ``warp_change`` by the camera's parameters, by the product rule.

    Those of the coverage are central differences over ``steps``. That of a face's signal is its layer's slope times the
    motion of the point seen.

    Parameters
    ----------
    warp
        The picture by faces.
    camera
        Camera at which the derivatives are taken.
    steps
        (10,) steps of ``camera.parameters``.

    Returns
    -------
    NDArray
        (10, band, y, x) derivatives.
    """
    ahead, behind = (
        [camera.with_parameters(camera.parameters + row) for row in np.diag(sign * steps)] for sign in (1, -1)
    )
    coverage, *others = _coverage(warp, [camera, *ahead, *behind])
    checkpoint()
    rises = (np.array(others[: len(steps)]) - others[len(steps) :]) / (2 * steps[:, None, None])
    border, own_face = np.nonzero((coverage > 0) | rises.any(axis=0))
    inside, alone = warp.inside
    pixel, face = np.append(inside, warp.border[border]), np.append(alone, own_face)
    share = np.append(np.ones(len(inside)), coverage[border, own_face])
    rise = np.hstack([np.zeros((len(steps), len(inside))), rises[:, border, own_face]])
    nearby = [camera.with_parameters(camera.parameters + row) for row in np.diag(_SMALL * steps)]
    result = np.zeros((len(steps), warp.base[0].size, len(warp.base)))
    for start in range(0, len(pixel), _PIXELS_PER_STEP):
        checkpoint()
        part = slice(start, start + _PIXELS_PER_STEP)
        first = np.flatnonzero(np.append(True, np.diff(pixel[part])))
        positions = _seen_at(warp, camera, face[part], pixel[part])
        value, down, right = _layers_at(warp, face[part], *_filled(warp, positions, pixel[part]), slopes=True)
        for derivative, other, step, up in zip(result, nearby, steps, rise, strict=True):
            checkpoint()
            rows, columns = (_seen_at(warp, other, face[part], pixel[part]) - positions) / (_SMALL * step)
            moved = np.nan_to_num(rows)[:, None] * down + np.nan_to_num(columns)[:, None] * right
            derivative[pixel[part][first]] += np.add.reduceat(share[part, None] * moved + up[part, None] * value, first)
    return np.moveaxis(result, 2, 1).reshape(len(steps), *warp.base.shape)


def _change(warp: Warp, camera: Camera, coverage: NDArray[np.float32]) -> NDArray[np.float64]:
    """``warp_change``. coverage : (n, k) of ``camera``, see ``_coverage``."""
    result = np.zeros((warp.base[0].size, len(warp.base)))
    inside, own_face = warp.inside
    for start in range(0, len(inside), _PIXELS_PER_STEP):
        checkpoint()
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
    """(n, band) values of the layers ``face`` where ``camera`` sees them in some pixels."""
    return _layers_at(warp, face, *_filled(warp, _seen_at(warp, camera, face, pixel), pixel))[0]


def _filled(warp: Warp, positions: NDArray[np.float64], pixel: NDArray) -> NDArray[np.float64]:
    """(2, n) rows and columns, those of the pixels themselves where they are not known."""
    return np.where(np.isnan(positions), np.divmod(pixel, warp.layers.shape[2]), positions)


def _layers_at(
    warp: Warp, face: NDArray, rows: NDArray, columns: NDArray, *, slopes: bool = False
) -> list[NDArray[np.float64]]:
    """(n, band) values of the layers ``face`` at positions clipped to the picture, interpolated.

    With ``slopes`` also their derivatives along rows and along columns of positions.
    """
    height, width = warp.layers.shape[1:3]
    row, *down = _cubic(rows, height)
    column, *right = _cubic(columns, width)
    samples = ((face[:, None] * height + row)[..., None] * width + column[:, None]).reshape(len(face), 16)
    flat = warp.layers.reshape(-1, warp.layers.shape[-1])
    ends = np.arange(0, samples.size + 1, 16)
    pairs = [(down[0], right[0]), (down[1], right[0]), (down[0], right[1])] if slopes else [(down[0], right[0])]
    return [
        csr_array(
            ((row_weight[..., None] * column_weight[:, None]).ravel(), samples.ravel(), ends), (len(samples), len(flat))
        )
        @ flat
        for row_weight, column_weight in pairs
    ]


def _cubic(position: NDArray[np.float64], size: int) -> tuple[NDArray[np.int64], NDArray, NDArray]:
    """(n, 4) neighbours of positions (n,) along an axis, their weights, and the weights' slopes.

    After Keys, IEEE Trans. ASSP 29, 1981. Where pixels meet the signal has the same slope on both sides; with straight
    lines between pixels a motion of 0.05 px was wrong by 0.16 of chi2 per sample (128 x 128 pixels).
    """
    position = np.clip(position, 0, size - 1)
    before = position.astype(int)
    t = position - before
    powers = np.stack([np.ones_like(t), t, t**2, t**3], axis=1)
    rising = np.stack([np.zeros_like(t), np.ones_like(t), 2 * t, 3 * t**2], axis=1)
    neighbours = np.clip(before[:, None] + [-1, 0, 1, 2], 0, size - 1)
    return neighbours, powers @ _KEYS, rising @ _KEYS


def _continued(signal: NDArray, inside: NDArray) -> NDArray[np.float64]:
    """Signals (y, x, band); pixels not ``inside`` (y, x) have those of the nearest one that is."""
    rows, columns = distance_transform_edt(~inside, return_distances=False, return_indices=True)
    return signal[rows, columns]


def _seen_at(warp: Warp, camera: Camera, face: NDArray, pixel: NDArray) -> NDArray[np.float64]:
    """(2, n) rows and columns in the warp's picture of what ``camera`` sees at some pixels.

    Of each pixel's middle on a face. NaN where the face only touches the pixel and the ray in its middle misses it.
    """
    rows, columns = np.divmod(pixel, warp.layers.shape[2])
    triangle = np.array([np.argmax(warp.tracer.facet == f) for f in warp.faces])
    corner, normal = warp.tracer.vertices[triangle, 0], warp.tracer.normals[triangle]
    heights = np.sum((corner - camera.position_mm) * normal, axis=1)
    direction = camera.directions(columns, rows)
    slope = np.einsum("ni,ni->n", direction, normal[face])
    with np.errstate(divide="ignore", invalid="ignore"):
        points = camera.position_mm + (heights[face] / slope)[:, None] * direction
        u, v = warp.camera.project(points).T
    return np.where(np.hypot(u - columns, v - rows) < _LOST_PX, [v, u], np.nan)


def pixels_per_unit(tracer: Tracer, camera: Camera) -> NDArray[np.float64]:
    """Motion of the picture per unit of each camera parameter.

    Parameters
    ----------
    tracer
        Geometry, for its corners.
    camera
        The camera.

    Returns
    -------
    NDArray
        (10,) rms motion of the corners inside the image, px per unit. Where it shows none, of all in front of the
        camera.

    Raises
    ------
    InputError
        If no corner is in front of the camera.
    """
    points = tracer.vertices.reshape(-1, 3)
    image = camera.project(points)
    inside = np.all((image > -0.5) & (image < [camera.width_px, camera.height_px]), axis=1)
    inside = inside if inside.any() else np.isfinite(image).all(axis=1)
    if not inside.any():
        raise InputError("camera", "the scene behind it", "a camera that sees the scene", "Is it the right box?")
    step = 1e-4
    motion = [
        camera.with_parameters(camera.parameters + step * axis).project(points) - image
        for axis in np.eye(len(PARAMETER_NAMES))
    ]
    return np.array([np.sqrt(np.mean(np.sum(m[inside] ** 2, axis=1))) for m in motion]) / step
