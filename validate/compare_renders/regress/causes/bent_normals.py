"""Shading normals that are bent on a face, or rounded over a block.

A pixel's light is a sum over directions of radiance times the cosine to the normal. Patch transport knows both: light
straight from the lamps, and the patches that a pixel's surface sees. A bent normal changes the cosines alone. What the
surface sends on to others changes in the second order, which is left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from cboxlab.rendering.perturbation import PatchLight
from numpy.typing import NDArray

from .cause import Cause, Pictures, Trial

__all__ = ["CAUSE"]

#: Least cosine between a normal and a direction: light from below a bent horizon is cut off, not amplified.
_LEAST_COSINE = 0.2
#: Largest tangent of the angle by which a normal is bent.
_LARGEST = 0.7
#: Fewest pixels of a face.
_FEWEST_PIXELS = 12
#: Part of a unit vector's cross product with a normal, from which both span a plane.
_APART = 0.5


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """Two slopes for each face of the scene, and one rounding for each surface of several faces."""
    scene = pictures.scene
    if scene is None:
        return
    light = scene.light
    transport = light.transport
    across = _first_moment(light)
    names = [surface.name for surface in scene.scene.surfaces]
    for face in np.unique(transport.face):
        mask = transport.face == face
        if mask.sum() < _FEWEST_PIXELS or transport.surface[mask][0] >= len(names):
            continue
        axes = _tangents(transport.normal[mask][0])
        templates = [pictures.change(scene.picture + _picture(light, across, mask[:, None] * axis)) for axis in axes]
        name = names[int(transport.surface[mask][0])]
        yield Trial(partial(_bent, name, transport.normal[mask][0]), tuple(templates), selected=1)
    for number, name in enumerate(names):
        mask = transport.surface == number
        if mask.sum() < _FEWEST_PIXELS or np.unique(transport.face[mask]).size < 2:
            continue
        away = transport.position - transport.position[mask].mean(axis=0)
        away /= max(float(np.abs(away[mask]).max()), 1e-9)
        tangential = away - (away * transport.normal).sum(axis=1, keepdims=True) * transport.normal
        template = pictures.change(scene.picture + _picture(light, across, mask[:, None] * tangential))
        yield Trial(partial(_rounded, name), (template,), selected=1)


def _first_moment(light: PatchLight) -> NDArray[np.float64]:
    """(f, w, 3) sum over directions of the light of each fragment times direction over cosine."""
    transport, patches = light.transport, light.transport.light.patches
    moment = np.zeros((*light.fragment_direct.shape, 3))
    for lamp, direct, shares in zip(light.scene.lamps, transport.direct.T, light.lamp_shares, strict=True):
        towards = _over_cosine(lamp.surface.vertices_mm.mean(axis=0) - transport.position, transport.normal)
        moment += (direct[:, None] * shares)[:, :, None] * towards[:, None, :]
    gather = transport.gather.tocoo()
    directions = _over_cosine(patches.centre[gather.col] - transport.position[gather.row], transport.normal[gather.row])
    arriving = light.patch_radiance()
    for axis in range(3):
        weighted = gather.copy()
        weighted.data = gather.data * directions[:, axis]
        moment[..., axis] += weighted.tocsr() @ arriving
    return np.asarray(moment)


def _over_cosine(towards: NDArray[np.float64], normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) unit vectors over their cosines to the normals."""
    unit = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    cosine = np.maximum(np.abs((unit * normal).sum(axis=1, keepdims=True)), _LEAST_COSINE)
    return np.asarray(unit / cosine)


def _picture(light: PatchLight, moment: NDArray[np.float64], bend: NDArray[np.float64]) -> NDArray[np.float64]:
    """(w, y, x) change of the picture by what is added to the normals (f, 3)."""
    return light.transport.pixels(light.fragment_reflectance * np.einsum("fwk,fk->fw", moment, bend))


def _tangents(normal: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two unit vectors in a face."""
    axis = next(unit for unit in np.eye(3) if np.linalg.norm(np.cross(unit, normal)) > _APART)
    first = np.cross(normal, axis)
    first /= np.linalg.norm(first)
    return first, np.cross(normal, first)


def _bent(name: str, normal: NDArray[np.float64], amplitudes: NDArray[np.float64]) -> dict[str, object] | None:
    """Parameters of a bent face."""
    tangent = float(np.hypot(*amplitudes))
    if tangent > _LARGEST:
        return None
    first, second = _tangents(normal)
    towards = amplitudes[0] * first + amplitudes[1] * second
    axis = int(np.argmax(np.abs(towards)))
    direction = f"{'-' if towards[axis] < 0 else '+'}{'xyz'[axis]}"
    return {"surface": name, "bent_deg": float(np.degrees(np.arctan(tangent))), "towards": direction}


def _rounded(name: str, amplitudes: NDArray[np.float64]) -> dict[str, object] | None:
    """Parameters of rounded normals."""
    tangent = abs(float(amplitudes[0]))
    if tangent > _LARGEST:
        return None
    values = {"surface": name, "bent_at_the_corners_deg": float(np.degrees(np.arctan(tangent)))}
    return {**values, "rounded": "outwards" if amplitudes[0] > 0 else "inwards"}


CAUSE = Cause(
    "bent-normals",
    "Shading normals are not those of the geometry: a face's normal is bent, or normals are smoothed over a block.",
    _trials,
    needs_scene=True,
    edge_error=0.15,
)
