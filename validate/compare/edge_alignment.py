"""Geometry errors of camera and objects, from the positions of edges in the photograph.

Pattanaik et al. (1997) attribute most of their mismatch to errors in the geometry. The offsets o along the edges'
normals n (``edge_offsets``) determine a correction of the camera and one translation per object,

    o = n . (dP/dcamera delta + dP/dpoint t_object),

with the calibration's covariance as prior for the camera. The room defines the axes and is fixed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from cboxlab.calibration.geometry import parameter_jacobian
from cboxlab.calibration.instrument import Mask
from cboxlab.calibration.result import Calibration, wireframe
from cboxlab.scenes import Scene
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from .edge_offsets import EdgeOffsets, measure_edges

__all__ = ["EDGE_BIAS_PX", "ObjectError", "align_edges", "align_photograph", "refine_geometry"]

#: Standard deviation of the position of an entire edge, and of its rotation (at the ends), px: shading and contact
#: shadows shift and rotate the apparent edge.
EDGE_BIAS_PX = 0.1

#: Samples whose residual is larger than this many standard deviations are outliers.
_OUTLIER_SIGMAS = 3.5

#: Rounds of fit and choice of outliers.
_OUTLIER_ROUNDS = 8

#: Largest uncertainty of projected corners, px: with a larger one, edges may be confused or outside the search range.
_LARGEST_SIGMA_PX = 1.5

#: Fewest samples that determine the shift of an object.
_FEWEST_SAMPLES = 10

#: Largest number of searches, each from the camera of the one before.
_SEARCHES = 6

#: Prior of an object's shift, mm: weak, for directions that the edges do not determine.
_SHIFT_PRIOR_MM = 500.0

#: A search ends the iteration if no parameter changes by more than this many of its standard deviations.
_SETTLED_SIGMAS = 0.1


@dataclass(frozen=True, eq=False)
class ObjectError:
    """Measured minus modelled position of an object."""

    #: Name of the object; "room" for the one that defines the axes.
    name: str

    #: (3,) measured minus modelled position, mm; zero for the room, NaN if too few samples determine it.
    shift_mm: NDArray[np.float64]

    #: (3, 3) covariance, mm^2, including EDGE_BIAS_PX for every edge and the camera's covariance.
    covariance: NDArray[np.float64]

    #: Number of samples used.
    samples: int

    #: Rms of the offsets across the edges before the correction of camera and shift, px.
    rms_before_px: float

    #: Rms of the offsets after the correction, px.
    rms_after_px: float

    @property
    def determined(self) -> bool:
        """Whether enough samples determine the object's position."""
        return bool(np.isfinite(self.shift_mm).all())

    @property
    def record(self) -> dict[str, Any]:
        """The entry of ``objects`` in geometry.json."""
        return {
            "name": self.name,
            "shift_mm": self.shift_mm.tolist(),
            "covariance": self.covariance.tolist(),
            "samples": self.samples,
            "rms_before_px": self.rms_before_px,
            "rms_after_px": self.rms_after_px,
        }


def align_edges(
    offsets: EdgeOffsets, camera: Camera, seen_from: Camera | None = None
) -> tuple[Camera, tuple[ObjectError, ...]]:
    """Refine the camera by the edges, and measure the errors of the objects.

    The covariances include that of the calibrated camera, the scatter of the samples along an edge, and EDGE_BIAS_PX
    for every edge.

    Parameters
    ----------
    offsets
        Measured offsets.
    camera
        Camera as calibrated, with its covariance.
    seen_from
        Camera by which the offsets were measured; None for ``camera``.

    Returns
    -------
    Camera
        Refined camera with its covariance.
    tuple of ObjectError
        The room first. The shift of an object with too few samples is NaN.

    Raises
    ------
    ValueError
        For a camera without covariance, and for too few samples on the room.
    """
    if camera.covariance is None:
        raise ValueError("the camera has no covariance, which the fit to the edges needs as prior")
    counts = np.bincount(offsets.owner, minlength=max(len(offsets.objects), 1))
    if counts[0] < _FEWEST_SAMPLES:
        raise ValueError("too few edges of the room are visible to define the axes")
    blocks = [k for k in range(1, len(offsets.objects)) if counts[k] >= _FEWEST_SAMPLES]
    used = np.isin(offsets.owner, [0, *blocks])
    start = seen_from or camera
    design = _design(offsets, start, blocks)
    prior: NDArray[np.float64] = np.zeros((design.shape[1],) * 2)
    prior[:10, :10] = np.linalg.inv(camera.covariance)
    prior[10:, 10:] = np.eye(3 * len(blocks)) / _SHIFT_PRIOR_MM**2
    expected = np.zeros(design.shape[1])
    expected[:10] = camera.parameters - start.parameters
    keep, values, sigma = used.copy(), np.zeros(design.shape[1]), 1.0
    residual: NDArray[np.float64] = offsets.offset_px
    inverse: NDArray[np.float64] = prior
    for _ in range(_OUTLIER_ROUNDS):
        rows, right = _whitened(design, offsets, keep, sigma)
        inverse = np.asarray(np.linalg.inv(rows.T @ rows + prior), np.float64)
        values = inverse @ (rows.T @ right + prior @ expected)
        residual = offsets.offset_px - design @ values
        sigma = _scatter(residual[keep], offsets.edge[keep])
        keep = used & (np.abs(residual) < _OUTLIER_SIGMAS * np.hypot(sigma, EDGE_BIAS_PX))
    refined = replace(camera.with_parameters(start.parameters + values[:10]), covariance=inverse[:10, :10].copy())
    errors = []
    for block in (0, *blocks):
        members = keep & (offsets.owner == block)
        at = 10 + 3 * blocks.index(block) if block else None
        errors.append(
            ObjectError(
                offsets.objects[block],
                np.zeros(3) if at is None else values[at : at + 3],
                np.zeros((3, 3)) if at is None else inverse[at : at + 3, at : at + 3],
                int(members.sum()),
                float(np.sqrt(np.mean(offsets.offset_px[members] ** 2))),
                float(np.sqrt(np.mean(residual[members] ** 2))),
            )
        )
    nan = np.full((3, 3), np.nan)
    for block in range(1, len(offsets.objects)):
        if block not in blocks:
            count = int(counts[block])
            errors.append(ObjectError(offsets.objects[block], nan[0], nan, count, np.nan, np.nan))
    return refined, tuple(errors)


def _design(offsets: EdgeOffsets, camera: Camera, blocks: list[int]) -> NDArray[np.float64]:
    """(n, 10 + 3 blocks) derivatives of the offsets by camera parameters and shifts of blocks."""
    design = np.zeros((len(offsets.offset_px), 10 + 3 * len(blocks)))
    by_camera = parameter_jacobian(camera, offsets.place_mm).reshape(-1, 2, 10)
    design[:, :10] = np.einsum("ni,nij->nj", offsets.normal, by_camera)
    for axis in range(3):
        moved = camera.project(offsets.place_mm + np.eye(3)[axis]) - camera.project(offsets.place_mm)
        along = np.sum(offsets.normal * moved, axis=1)
        for rank, block in enumerate(blocks):
            design[:, 10 + 3 * rank + axis] = np.where(offsets.owner == block, along, 0.0)
    return design


def _whitened(
    design: NDArray[np.float64], offsets: EdgeOffsets, keep: NDArray[np.bool_], sigma: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Design and offsets, transformed to independent errors of unit variance.

    The errors are sigma for each sample, EDGE_BIAS_PX common to the samples of an edge, and EDGE_BIAS_PX at the ends
    of an edge for a linear drift along it.
    """
    rows = np.column_stack([design, offsets.offset_px])[keep] / sigma
    edge, position = offsets.edge[keep], offsets.place_mm[keep]
    for number in np.unique(edge):
        members = edge == number
        along = position[members] @ (position[members][-1] - position[members][0])
        along = along - along.mean()
        for shape in (np.ones(along.size), along / max(float(np.abs(along).max()), 1e-12)):
            size = float(shape @ shape)
            if size > 0:
                shrink = 1 - (1 + size * (EDGE_BIAS_PX / sigma) ** 2) ** -0.5
                rows[members] -= shrink / size * np.outer(shape, shape @ rows[members])
    return rows[:, :-1], rows[:, -1]


def _scatter(residual: NDArray[np.float64], edge: NDArray[np.int64]) -> float:
    """Standard deviation of the samples about the mean of their edge.

    Not a median: edges along a row of pixels scatter less than slanted ones and may be the majority.
    """
    _, which, count = np.unique(edge, return_inverse=True, return_counts=True)
    about_mean = residual - (np.bincount(which, residual) / count)[which]
    return float(max(np.sqrt(np.sum(about_mean**2) / max(residual.size - count.size, 1)), 1e-4))


def align_photograph(
    photograph: NDArray[np.float64], camera: Camera, scene: Scene
) -> tuple[Camera, tuple[ObjectError, ...]]:
    """Iterate ``measure_edges`` and ``align_edges`` until the camera does not change.

    The search range around each modelled edge is small. The iteration ends when no parameter of the camera changes by
    more than a tenth of its standard deviation.

    Parameters
    ----------
    photograph
        (y, x) any scale; NaN marks masked pixels.
    camera
        Camera as calibrated, with its covariance.
    scene
        Model of the scene.

    Returns
    -------
    Camera
        Refined camera with its covariance.
    tuple of ObjectError
        As of ``align_edges``.

    Raises
    ------
    ValueError
        As ``align_edges``, and for a camera so uncertain that edges may be confused.
    """
    refined = camera
    _require_precise(camera, scene)
    for _ in range(_SEARCHES):
        before = refined
        refined, errors = align_edges(measure_edges(photograph, before, scene), camera, before)
        change = refined.parameters - before.parameters
        if np.all(np.abs(change) < _SETTLED_SIGMAS * np.sqrt(np.diag(np.asarray(refined.covariance)))):
            break
    return refined, errors


def _require_precise(camera: Camera, scene: Scene) -> None:
    """Raise ValueError unless the camera projects the scene's corners precisely enough."""
    corners = np.unique(wireframe(scene).reshape(-1, 3).round(2), axis=0)
    by_camera = parameter_jacobian(camera, corners)
    if camera.covariance is None:
        raise ValueError("the camera has no covariance, which the fit to the edges needs as prior")
    variance = np.einsum("ni,ij,nj->n", by_camera, camera.covariance, by_camera)
    typical = float(np.sqrt(np.median(variance)))
    if typical > _LARGEST_SIGMA_PX:
        raise ValueError(
            f"corners are projected with an uncertainty of {typical:.1f} px; at most {_LARGEST_SIGMA_PX:g} px are "
            "allowed, so that edges are not confused"
        )


def refine_geometry(calibration: Calibration) -> tuple[Camera, tuple[ObjectError, ...]]:
    """Refine the camera of a capture and measure the errors of its objects by edges.

    The photograph is the mean of the bands.

    Parameters
    ----------
    calibration
        Calibration with a camera, of a capture that names its scene.

    Returns
    -------
    Camera
        Refined camera with its covariance.
    tuple of ObjectError
        As of ``align_edges``.

    Raises
    ------
    InputError
        If the capture has no camera or names no scene that can be loaded, and if too few edges are found.
    """
    scene, camera = calibration.capture.scene, calibration.camera
    where = calibration.capture.folder / "capture.toml"
    if camera is None:
        raise InputError(where, "no camera: no [geometry]", "surveyed points, to predict the edges of the box")
    if scene is None:
        name = calibration.capture.manifest.scene
        fault = "no scene" if name is None else f"scene {name!r}, which cannot be read"
        raise InputError(where, fault, "the scene, to predict the edges of the box")
    masked = np.any(calibration.images["mask"].values & ~np.uint8(Mask.OTHER_CHANNEL) != 0, axis=0)
    try:
        return align_photograph(np.where(masked, np.nan, calibration.photograph), camera, scene)
    except ValueError as error:
        raise InputError(where, str(error), "a photograph of the box and its camera") from None
