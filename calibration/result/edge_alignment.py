"""Geometry errors of objects, from their edges in the photograph relative to the model.

Pattanaik et al. (1997) attribute most of their mismatch to errors in the geometry. At points along every visible
edge, the photograph is sampled across the edge and a step with a separate slope on either side is fitted. The
offsets o along the edges' normals n determine a correction of the camera and one translation per object,

    o = n . (dP/dcamera delta + dP/dpoint t_object),

with the calibration's covariance as prior for the camera. The room defines the axes and is fixed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cboxlab.scenes import Scene
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.special import erf

from ..geometry import parameter_jacobian
from .calibrate import Calibration
from .geometry_plot import wireframe

__all__ = [
    "EDGE_BIAS_PX",
    "EdgeOffsets",
    "ObjectError",
    "align_edges",
    "align_photograph",
    "measure_edges",
    "refine_geometry",
]

#: Standard deviation, px, of the position of a whole edge, and of its rotation (at the ends): shading and contact
#: shadows shift and rotate the apparent edge.
EDGE_BIAS_PX = 0.1

#: Distance of samples along an edge, px.
_STEP_PX = 2.0
#: Half length of the profile across an edge, px.
_REACH_PX = 4.0
#: Largest offset that is searched, px.
_SEARCH_PX = 2.5
#: Blur of a step by the width of a pixel and the lens (standard deviation).
_BLUR_PX = 0.6
#: Smallest step of an edge, relative to the rms misfit of the model.
_CLEAR = 8.0
#: Residual beyond which a sample is not used, in standard deviations.
_OUTLIER_SIGMAS = 3.5
#: Largest uncertainty of projected corners; with a larger one, edges may lie outside the search range or be confused.
_LARGEST_SIGMA_PX = 1.5
#: Fewest samples that determine the position of an object.
_FEWEST = 10
#: Iterations of measurement and fit at most.
_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class EdgeOffsets:
    """Offsets of n samples along the edges of the model."""

    #: Names of the objects; empty without samples.
    objects: tuple[str, ...]
    #: (n, 3) points on the model's edges, mm.
    place_mm: NDArray[np.float64]
    #: (n, 2) unit normals of the edges in the image.
    normal: NDArray[np.float64]
    #: (n,) offset of the photograph's edge along the normal, px.
    offset_px: NDArray[np.float64]
    #: (n,) number of the edge.
    edge: NDArray[np.int64]
    #: (n,) index into `objects`.
    owner: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ObjectError:
    """Position error of one object."""

    #: Name of the object.
    name: str
    #: (3,) measured minus modelled position, mm; zero for the room, NaN if undetermined.
    shift_mm: NDArray[np.float64]
    #: (3, 3) of `shift_mm`, mm^2, including EDGE_BIAS_PX for every edge and the camera's covariance.
    covariance: NDArray[np.float64]
    #: Number of samples used.
    samples: int
    #: Root mean square offset across the edges before the correction of camera and shift, px.
    rms_before_px: float
    #: Root mean square offset after the correction, px.
    rms_after_px: float

    @property
    def known(self) -> bool:
        """Whether enough samples determine the position of the object."""
        return bool(np.isfinite(self.shift_mm).all())


def _objects(scene: Scene) -> list[tuple[str, list[int]]]:
    """Names and surface indices of the objects.

    Surfaces that share a corner form one object; the largest is the room, which comes first.
    """
    corners = [{tuple(np.round(v, 2)) for v in surface.vertices_mm} for surface in scene.surfaces]
    groups: list[list[int]] = []
    for index, of_surface in enumerate(corners):
        touching = [g for g in groups if any(corners[i] & of_surface for i in g)]
        joined = [i for group in touching for i in group]
        groups = [*(g for g in groups if g not in touching), [*joined, index]]
    areas = [sum(scene.surfaces[i].areas_mm2.sum() for i in g) for g in groups]
    order = np.argsort(areas)[::-1]
    return [
        ("room" if rank == 0 else "+".join(scene.surfaces[i].name for i in sorted(groups[k])), groups[k])
        for rank, k in enumerate(order)
    ]


def _visible(scene: Scene, camera: Camera, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) True where no face occludes the point (Moeller and Trumbore 1997)."""
    direction = points - camera.position_mm
    free: NDArray[np.bool_] = np.ones(len(points), bool)
    for surface in scene.surfaces:
        for face in surface.faces:
            a, b, c = surface.vertices_mm[face]
            normal = np.cross(direction, c - a)
            slope = normal @ (b - a)
            with np.errstate(divide="ignore", invalid="ignore"):
                from_a = camera.position_mm - a
                u = normal @ from_a / slope
                across = np.cross(from_a, b - a)
                v = direction @ across / slope
                distance = float((c - a) @ across) / slope
                hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 1e-6) & (distance < 1 - 1e-3)
            free &= ~(hit & np.isfinite(distance))
    return free


def _image_edges(scene: Scene, camera: Camera) -> NDArray[np.float64]:
    """(n, 4) points of all visible edges in the image, px, with their unit tangents."""
    parts = []
    for edge in wireframe(scene):
        ends = camera.project(edge)
        length = float(np.linalg.norm(ends[1] - ends[0]))
        if not np.isfinite(length) or length < 1:
            continue
        points = edge[0] + np.linspace(0, 1, int(length) + 2)[:, None] * (edge[1] - edge[0])
        image = camera.project(points)
        tangent = np.gradient(image, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        parts.append(np.hstack([image, tangent])[_visible(scene, camera, points)])
    return np.concatenate(parts)


def _crowded(
    image: NDArray[np.float64], tangent: NDArray[np.float64], others: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """(n,) True where a point of another edge is near a sample.

    Another edge is off the sample's line by more than half a pixel, or has another direction.
    """
    along = tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    apart = others[None, :, :2] - image[:, None]
    off = np.abs(apart[..., 0] * along[:, None, 1] - apart[..., 1] * along[:, None, 0])
    near = np.sum(apart**2, axis=-1) < (_REACH_PX + 1) ** 2
    turned = np.abs(along @ others[:, 2:].T) < 0.98
    return np.asarray(np.any(near & ((off > 0.5) | turned), axis=1), np.bool_)


def _across(profile: NDArray[np.float64], x: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """(n,) positions of the steps in profiles (n, len(x)), and step height over rms misfit."""
    positions = np.arange(-_SEARCH_PX, _SEARCH_PX + 0.01, 0.05)
    misfit, steps = np.empty((len(positions), len(profile))), np.empty((len(positions), len(profile)))
    for index, step in enumerate(positions):
        after = (1 + erf((x - step) / _BLUR_PX / np.sqrt(2))) / 2
        design = np.stack([np.ones_like(x), x - step, after, after * (x - step)], axis=1)
        fit, *_ = np.linalg.lstsq(design, profile.T, rcond=None)
        misfit[index] = np.sum((design @ fit - profile.T) ** 2, axis=0)
        steps[index] = fit[2]
    best = np.clip(misfit.argmin(axis=0), 1, len(positions) - 2)
    profiles = np.arange(len(profile))
    left, middle, right = (misfit[best + i, profiles] for i in (-1, 0, 1))
    bend = left - 2 * middle + right
    shift = np.where(bend > 0, (left - right) / (2 * np.maximum(bend, 1e-300)), 0.0)
    inside = (misfit.argmin(axis=0) > 0) & (misfit.argmin(axis=0) < len(positions) - 1)
    clear = np.abs(steps[best, profiles]) / np.sqrt(np.maximum(middle / (len(x) - 5), 1e-300))
    return positions[best] + 0.05 * np.clip(shift, -1, 1), np.where(inside, clear, 0.0)


def measure_edges(photograph: NDArray[np.float64], camera: Camera, scene: Scene) -> EdgeOffsets:
    """Offsets of all visible edges of the model in a photograph.

    Parameters
    ----------
    photograph
        (y, x) photograph in any unit; NaN marks masked pixels.
    camera
        Camera that projects the model's edges.
    scene
        Model of the box.

    Returns
    -------
    EdgeOffsets
        Samples with a clear step, every 2 px along the edges.
    """
    x = np.arange(-_REACH_PX, _REACH_PX + 0.01, 0.5)
    others = _image_edges(scene, camera)
    parts = []
    number = 0
    objects = _objects(scene)
    lamp = replace(scene, surfaces=())
    measured: set[frozenset[tuple[float, ...]]] = set()
    around_lamp = {tuple(np.round(corner, 2)) for corner in wireframe(lamp).reshape(-1, 3)}
    for owner, (_, members) in enumerate(objects):
        member = replace(scene, surfaces=tuple(scene.surfaces[i] for i in members))
        # Without the edges of the lamp (the last ones) and of its hole, which are too bright.
        for edge in wireframe(member)[: -len(wireframe(lamp))]:
            ends_mm = frozenset(tuple(np.round(end, 2)) for end in edge)
            # Two surfaces can share an edge: use it once.
            if ends_mm <= around_lamp or ends_mm in measured:
                continue
            measured.add(ends_mm)
            number += 1
            ends = camera.project(edge)
            length = float(np.linalg.norm(ends[1] - ends[0]))
            if not np.isfinite(length) or length < 4 * _STEP_PX:
                continue
            # Leave out the ends, near which other edges meet.
            share = np.arange(2 * _STEP_PX, length - 2 * _STEP_PX, _STEP_PX) / length
            points_mm = edge[0] + share[:, None] * (edge[1] - edge[0])
            image = camera.project(points_mm)
            tangent = camera.project(points_mm + 1e-3 * (edge[1] - edge[0])) - image
            normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            u, v = (image[:, i, None] + normal[:, i, None] * x for i in (0, 1))
            profile = map_coordinates(photograph, [v, u], order=1, mode="constant", cval=np.nan)
            usable = np.all(np.isfinite(profile), axis=1) & _visible(scene, camera, points_mm)
            usable &= ~_crowded(image, tangent, others)
            if not np.any(usable):
                continue
            offset, clear = _across(profile[usable], x)
            good = clear > _CLEAR
            index = np.flatnonzero(usable)[good]
            parts.append(
                (points_mm[index], normal[index], offset[good], np.full(index.size, number), np.full(index.size, owner))
            )
    if not parts:
        empty = np.zeros(0)
        return EdgeOffsets((), empty.reshape(0, 3), empty.reshape(0, 2), empty, empty.astype(int), empty.astype(int))
    points, normal, offset, edges, owners = (np.concatenate(column) for column in zip(*parts, strict=True))
    return EdgeOffsets(tuple(name for name, _ in objects), points, normal, offset, edges, owners)


def _whitened(
    design: NDArray[np.float64], offsets: EdgeOffsets, keep: NDArray[np.bool_], sigma: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Design and offsets, transformed to independent errors of unit variance.

    The errors are sigma for each sample, EDGE_BIAS_PX common to the samples of an edge, and EDGE_BIAS_PX at the ends
    of an edge for a linear drift along it.
    """
    rows = np.column_stack([design, offsets.offset_px])[keep] / sigma
    edge, points = offsets.edge[keep], offsets.place_mm[keep]
    for number in np.unique(edge):
        on_edge = edge == number
        along = points[on_edge] @ (points[on_edge][-1] - points[on_edge][0])
        along = along - along.mean()
        for shape in (np.ones(along.size), along / max(float(np.abs(along).max()), 1e-12)):
            size = float(shape @ shape)
            if size > 0:
                shrink = 1 - (1 + size * (EDGE_BIAS_PX / sigma) ** 2) ** -0.5
                rows[on_edge] -= shrink / size * np.outer(shape, shape @ rows[on_edge])
    return rows[:, :-1], rows[:, -1]


def _scatter(residual: NDArray[np.float64], edge: NDArray[np.int64]) -> float:
    """Standard deviation of the samples about the mean of their edge.

    Not a median: edges along a row of pixels scatter less than slanted ones and may be the majority.
    """
    _, which, count = np.unique(edge, return_inverse=True, return_counts=True)
    deviation = residual - (np.bincount(which, residual) / count)[which]
    return float(max(np.sqrt(np.sum(deviation**2) / max(residual.size - count.size, 1)), 1e-4))


def align_edges(
    offsets: EdgeOffsets, camera: Camera, seen_from: Camera | None = None
) -> tuple[Camera, tuple[ObjectError, ...]]:
    """Camera refined by the edges, with its covariance, and the errors of the objects.

    The covariances include that of the calibrated camera, the scatter of the samples along an edge, and EDGE_BIAS_PX
    for every edge. The shift of an object with too few samples is NaN.

    Parameters
    ----------
    offsets
        Samples along the edges.
    camera
        Camera as calibrated, with covariance.
    seen_from
        Camera with which the offsets were measured; None if it is `camera`.

    Returns
    -------
    Camera
        Refined camera with covariance.
    tuple[ObjectError, ...]
        Errors of the room (zero) and of the other objects.

    Raises
    ------
    ValueError
        For a camera without covariance, and for too few samples on the room.
    """
    if camera.covariance is None:
        raise ValueError("the camera has no covariance, which the fit to the edges needs as prior")
    counts = np.bincount(offsets.owner, minlength=max(len(offsets.objects), 1))
    if counts[0] < _FEWEST:
        raise ValueError("too few edges of the room are visible to define the axes")
    blocks = [k for k in range(1, len(offsets.objects)) if counts[k] >= _FEWEST]
    used = np.isin(offsets.owner, [0, *blocks])
    design = np.zeros((len(offsets.offset_px), 10 + 3 * len(blocks)))
    start = seen_from or camera
    by_camera = parameter_jacobian(start, offsets.place_mm).reshape(-1, 2, 10)
    design[:, :10] = np.einsum("ni,nij->nj", offsets.normal, by_camera)
    for axis in range(3):
        moved = start.project(offsets.place_mm + np.eye(3)[axis]) - start.project(offsets.place_mm)
        along = np.sum(offsets.normal * moved, axis=1)
        for rank, block in enumerate(blocks):
            design[:, 10 + 3 * rank + axis] = np.where(offsets.owner == block, along, 0.0)
    # A weak prior of 500 mm for directions that the edges do not determine.
    prior: NDArray[np.float64] = np.zeros((design.shape[1],) * 2)
    prior[:10, :10] = np.linalg.inv(camera.covariance)
    prior[10:, 10:] = np.eye(3 * len(blocks)) / 500.0**2
    expected = np.zeros(design.shape[1])
    expected[:10] = camera.parameters - start.parameters
    keep, values, sigma = used.copy(), np.zeros(design.shape[1]), 1.0
    residual: NDArray[np.float64] = offsets.offset_px
    inverse: NDArray[np.float64] = prior
    for _ in range(8):
        rows, right = _whitened(design, offsets, keep, sigma)
        inverse = np.asarray(np.linalg.inv(rows.T @ rows + prior), np.float64)
        values = inverse @ (rows.T @ right + prior @ expected)
        residual = offsets.offset_px - design @ values
        sigma = _scatter(residual[keep], offsets.edge[keep])
        keep = used & (np.abs(residual) < _OUTLIER_SIGMAS * np.hypot(sigma, EDGE_BIAS_PX))
    refined = replace(camera.with_parameters(start.parameters + values[:10]), covariance=inverse[:10, :10].copy())
    errors = []
    for block in (0, *blocks):
        of_object = keep & (offsets.owner == block)
        at = 10 + 3 * blocks.index(block) if block else None
        errors.append(
            ObjectError(
                offsets.objects[block],
                np.zeros(3) if at is None else values[at : at + 3],
                np.zeros((3, 3)) if at is None else inverse[at : at + 3, at : at + 3],
                int(of_object.sum()),
                float(np.sqrt(np.mean(offsets.offset_px[of_object] ** 2))),
                float(np.sqrt(np.mean(residual[of_object] ** 2))),
            )
        )
    nan = np.full((3, 3), np.nan)
    for block in range(1, len(offsets.objects)):
        if block not in blocks:
            count = int(counts[block])
            errors.append(ObjectError(offsets.objects[block], nan[0], nan, count, np.nan, np.nan))
    return refined, tuple(errors)


def _require_precise(camera: Camera, scene: Scene) -> None:
    """Raise ValueError for a camera so uncertain that edges may be confused."""
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


def align_photograph(
    photograph: NDArray[np.float64], camera: Camera, scene: Scene
) -> tuple[Camera, tuple[ObjectError, ...]]:
    """Refined camera and object errors by iterating ``measure_edges`` and ``align_edges``.

    The search range around each modelled edge is small, which the iteration overcomes. It ends when the camera changes
    by less than a tenth of its sigmas.

    Parameters
    ----------
    photograph
        (y, x) photograph in any unit; NaN marks masked pixels.
    camera
        Camera as calibrated, with covariance.
    scene
        Model of the box.

    Returns
    -------
    Camera
        Refined camera with covariance.
    tuple[ObjectError, ...]
        Errors of the room (zero) and of the other objects.

    Raises
    ------
    ValueError
        As ``align_edges``, and for a camera so uncertain that edges may be confused.
    """
    refined = camera
    _require_precise(camera, scene)
    for _ in range(_ROUNDS):
        before = refined
        refined, errors = align_edges(measure_edges(photograph, before, scene), camera, before)
        moved = refined.parameters - before.parameters
        if np.all(np.abs(moved) < 0.1 * np.sqrt(np.diag(np.asarray(refined.covariance)))):
            break
    return refined, errors


def refine_geometry(calibration: Calibration) -> tuple[Camera, tuple[ObjectError, ...]]:
    """Refined camera of a calibrated capture and the error of every object.

    The edges are those in the mean of its bands.

    Parameters
    ----------
    calibration
        Calibration with a camera, of a capture with a scene.

    Returns
    -------
    Camera
        Refined camera with covariance.
    tuple[ObjectError, ...]
        Errors of the room (zero) and of the other objects.

    Raises
    ------
    InputError
        If the capture has no camera or no scene that can be loaded, and if too few edges are found.
    """
    scene, camera = calibration.capture.known_scene(), calibration.camera
    where = calibration.capture.folder / "capture.toml"
    if camera is None:
        raise InputError(where, "no camera: no [geometry]", "surveyed points, to predict the edges of the box")
    if scene is None:
        scene_name = calibration.capture.manifest.scene
        fault = "no scene" if scene_name is None else f"scene {scene_name!r}, which cannot be read"
        raise InputError(where, fault, "the scene, to predict the edges of the box")
    out = np.any(calibration.images["mask"].values != 0, axis=0)
    try:
        return align_photograph(np.where(out, np.nan, calibration.photograph), camera, scene)
    except ValueError as error:
        raise InputError(where, str(error), "a photograph of the box and its camera") from None
