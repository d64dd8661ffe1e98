"""Positions of objects' edges in a photograph relative to the model's edges.

At points along every visible edge, the photograph is sampled across the edge, and a step with a separate slope on
either side is fitted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cboxlab.calibration.result import wireframe
from cboxlab.scenes import Scene
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.special import erf

__all__ = ["EdgeOffsets", "are_visible", "measure_edges"]

#: Distance between samples along an edge, px: nearer ones would share pixels and so their noise.
_SAMPLE_SPACING_PX = 2.0

#: Half the length of a profile across an edge, px: long enough for a slope on either side of the step.
_REACH_PX = 4.0

#: Distance between the values of a profile, px.
_PROFILE_SPACING_PX = 0.5

#: Largest offset that is searched, px: the profile then has 1.5 px or more on either side of the step.
_SEARCH_PX = 2.5

#: Spacing of the searched offsets, px; the minimum between them is that of a parabola.
_SEARCH_SPACING_PX = 0.05

#: Blur of a step by the width of a pixel and the lens (standard deviation), px.
_BLUR_PX = 0.6

#: Smallest step of an edge over the rms misfit of the fitted profile.
_SMALLEST_STEP = 8.0

#: Largest distance of a point of the same edge from the sample's line, px.
_SAME_LINE_PX = 0.5

#: Smallest cosine between two directions of the same edge.
_SAME_DIRECTION_COSINE = 0.98


@dataclass(frozen=True, eq=False)
class EdgeOffsets:
    """Offsets of n samples along the edges of a scene."""

    #: Names of the objects, the room first.
    objects: tuple[str, ...]

    #: (n, 3) position on the model's edge, mm.
    place_mm: NDArray[np.float64]

    #: (n, 2) unit normal of the edge in the image.
    normal: NDArray[np.float64]

    #: (n,) offset of the photograph's edge from the model's along the normal, px.
    offset_px: NDArray[np.float64]

    #: (n,) number of the edge.
    edge: NDArray[np.int64]

    #: (n,) index of the object in ``objects``.
    owner: NDArray[np.int64]


def measure_edges(photograph: NDArray[np.float64], camera: Camera, scene: Scene) -> EdgeOffsets:
    """Measure the offsets of all visible edges in a photograph.

    The edges of the lamp and of its opening are left out, because they are too bright.

    Parameters
    ----------
    photograph
        (y, x) any scale; NaN marks masked pixels.
    camera
        Camera by which the model's edges are projected.
    scene
        Model of the scene.

    Returns
    -------
    EdgeOffsets
        No samples if no edge is clear enough.
    """
    x = np.arange(-_REACH_PX, _REACH_PX + 0.01, _PROFILE_SPACING_PX)
    others = _image_edges(scene, camera)
    parts = []
    number = 0
    objects = _objects(scene)
    lamp = replace(scene, surfaces=())
    used: set[frozenset[tuple[float, ...]]] = set()
    around_lamp = {tuple(np.round(corner, 2)) for corner in wireframe(lamp).reshape(-1, 3)}
    for owner, (_, members) in enumerate(objects):
        body = replace(scene, surfaces=tuple(scene.surfaces[i] for i in members))
        for edge in wireframe(body)[: -len(wireframe(lamp))]:
            ends_mm = frozenset(tuple(np.round(end, 2)) for end in edge)
            # Two surfaces can share an edge: use it once.
            if ends_mm <= around_lamp or ends_mm in used:
                continue
            used.add(ends_mm)
            number += 1
            ends = camera.project(edge)
            length = float(np.linalg.norm(ends[1] - ends[0]))
            if not np.isfinite(length) or length < 4 * _SAMPLE_SPACING_PX:
                continue
            # Leave out the ends, near which other edges meet.
            share = np.arange(2 * _SAMPLE_SPACING_PX, length - 2 * _SAMPLE_SPACING_PX, _SAMPLE_SPACING_PX) / length
            positions = edge[0] + share[:, None] * (edge[1] - edge[0])
            image = camera.project(positions)
            tangent = camera.project(positions + 1e-3 * (edge[1] - edge[0])) - image
            normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            u, v = (image[:, i, None] + normal[:, i, None] * x for i in (0, 1))
            profile = map_coordinates(photograph, [v, u], order=1, mode="constant", cval=np.nan)
            usable = np.all(np.isfinite(profile), axis=1) & are_visible(scene, camera, positions)
            usable &= ~_crowded(image, tangent, others)
            if not np.any(usable):
                continue
            offset, clearness = _step_positions(profile[usable], x)
            clear = clearness > _SMALLEST_STEP
            index = np.flatnonzero(usable)[clear]
            parts.append(
                (
                    positions[index],
                    normal[index],
                    offset[clear],
                    np.full(index.size, number),
                    np.full(index.size, owner),
                )
            )
    if not parts:
        empty = np.zeros(0)
        return EdgeOffsets((), empty.reshape(0, 3), empty.reshape(0, 2), empty, empty.astype(int), empty.astype(int))
    position, normal, offset, edges, owners = (np.concatenate(column) for column in zip(*parts, strict=True))
    return EdgeOffsets(tuple(name for name, _ in objects), position, normal, offset, edges, owners)


def _objects(scene: Scene) -> list[tuple[str, list[int]]]:
    """Names and surface indices of the objects, the room first.

    Surfaces that share a corner form one object; the largest object is the room.
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


def are_visible(scene: Scene, camera: Camera, positions: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether a camera sees positions of a scene.

    Intersection by Möller and Trumbore (1997) in double precision: the positions lie on edges, where single precision
    would decide by chance whether the next face hides them.

    Parameters
    ----------
    scene
        Model of the scene.
    camera
        The camera.
    positions
        (n, 3) positions on edges or corners, mm.

    Returns
    -------
    NDArray
        (n,) True where no face hides the position.
    """
    corners = np.concatenate([surface.vertices_mm[surface.faces] for surface in scene.surfaces])
    direction = positions - camera.position_mm
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    from_a = camera.position_mm - a
    across = np.cross(from_a, ab)
    # the determinants are linear in the direction, so that a product has them for all faces
    slope, first, second = (direction @ side.T for side in (np.cross(ac, ab), np.cross(ac, from_a), across))
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v, distance = first / slope, second / slope, np.sum(ac * across, axis=1) / slope
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 1e-6) & (distance < 1 - 1e-3)
    return np.asarray(~np.any(hit & np.isfinite(distance), axis=1), np.bool_)


def _image_edges(scene: Scene, camera: Camera) -> NDArray[np.float64]:
    """(n, 4) points of all visible edges in the image, px, with their unit tangents."""
    parts = []
    for edge in wireframe(scene):
        ends = camera.project(edge)
        length = float(np.linalg.norm(ends[1] - ends[0]))
        if not np.isfinite(length) or length < 1:
            continue
        positions = edge[0] + np.linspace(0, 1, int(length) + 2)[:, None] * (edge[1] - edge[0])
        image = camera.project(positions)
        tangent = np.gradient(image, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        parts.append(np.hstack([image, tangent])[are_visible(scene, camera, positions)])
    return np.concatenate(parts)


def _crowded(
    image: NDArray[np.float64], tangent: NDArray[np.float64], others: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """(n,) True where a point of another edge is near: off the line, or of another direction."""
    along = tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    apart = others[None, :, :2] - image[:, None]
    distance = np.abs(apart[..., 0] * along[:, None, 1] - apart[..., 1] * along[:, None, 0])
    near = np.sum(apart**2, axis=-1) < (_REACH_PX + 1) ** 2
    turned = np.abs(along @ others[:, 2:].T) < _SAME_DIRECTION_COSINE
    return np.asarray(np.any(near & ((distance > _SAME_LINE_PX) | turned), axis=1), np.bool_)


def _step_positions(profile: NDArray[np.float64], x: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """(n,) positions of steps in profiles (n, len(x)), and their height over the rms misfit."""
    offsets = np.arange(-_SEARCH_PX, _SEARCH_PX + 0.01, _SEARCH_SPACING_PX)
    misfit, steps = np.empty((len(offsets), len(profile))), np.empty((len(offsets), len(profile)))
    for index, offset in enumerate(offsets):
        after = (1 + erf((x - offset) / _BLUR_PX / np.sqrt(2))) / 2
        design = np.stack([np.ones_like(x), x - offset, after, after * (x - offset)], axis=1)
        fit, *_ = np.linalg.lstsq(design, profile.T, rcond=None)
        misfit[index] = np.sum((design @ fit - profile.T) ** 2, axis=0)
        steps[index] = fit[2]
    best = np.clip(misfit.argmin(axis=0), 1, len(offsets) - 2)
    columns = np.arange(len(profile))
    left, middle, right = (misfit[best + i, columns] for i in (-1, 0, 1))
    bend = left - 2 * middle + right
    shift = np.where(bend > 0, (left - right) / (2 * np.maximum(bend, 1e-300)), 0.0)
    inside = (misfit.argmin(axis=0) > 0) & (misfit.argmin(axis=0) < len(offsets) - 1)
    clear = np.abs(steps[best, columns]) / np.sqrt(np.maximum(middle / (len(x) - 5), 1e-300))
    return offsets[best] + _SEARCH_SPACING_PX * np.clip(shift, -1, 1), np.where(inside, clear, 0.0)
