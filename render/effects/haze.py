"""Haze: the air scatters, everywhere between camera and back wall.

Radiance falls along each path of length l as exp(-sigma l). The air's radiance source is albedo sigma times the mean
radiance that arrives, alike in all directions. All orders of scattering between cells of air, patches and lamp are
counted. The cause is dust, smoke or fog in the box.

Parameters: extinction_per_m, sigma, m^-1, null value 0; albedo of single scattering, without unit, no null value.
Sources: Chandrasekhar, 'Radiative Transfer', 1950; Hottel and Sarofim, 'Radiative Transfer', 1967 (zones of gas).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from ..perturbation import STEPS, AirTransport, PatchLight, PatchTransport, air_transport
from .effect import Effect, Parameter

__all__ = ["EFFECT"]

#: Number of nearest patches from which light from the air onto a fragment is interpolated.
_NEIGHBOURS = 4

#: Most rounds of exchange between air and surfaces. Each adds about extinction times path length of the one before.
_ROUNDS = 6

#: Relative change of the air's light below which the rounds end: far below the noise of a rendering.
_SETTLED = 1e-5

#: Rows of a table of distances that are computed at once: their numbers stay in the processor's cache.
_ROWS = 64

#: Fragments whose distances to their patches are computed at once, to bound the memory of the distances.
_FRAGMENTS = 1024


def _apply(light: PatchLight, extinction_per_m: float, albedo: float) -> PatchLight:
    """Light with attenuation along every path, and all orders of scattering.

    Light is exchanged between cells of air, patches and lamps in rounds, until the air's radiance has settled.
    """
    if extinction_per_m == 0:
        return light
    sigma = extinction_per_m * 1e-3
    transport = light.transport
    patches = transport.light.patches
    air = air_transport(transport)
    hazy = _attenuated(transport, [lamp.centre for lamp in air.lamps], sigma)
    changed = light.change(transport=hazy)

    from_patches = air.patch_coverage * _passed(air.centres, patches.centre, sigma)
    # by reciprocity, from the part of its view that each patch fills for a cell of air
    onto_patches = (4 * air.volume.astype(np.float32)[:, None] * from_patches).T / patches.area.astype(np.float32)[
        :, None
    ]
    from_each = [lamp.cells * np.exp(-sigma * np.linalg.norm(air.centres - lamp.centre, axis=1)) for lamp in air.lamps]
    from_lamps = np.stack(from_each, axis=1) @ light.lamp_shares
    surround = np.outer(air.escape, light.surround)
    between = air.between_cells(sigma)
    source = np.zeros((len(air.volume), len(light.surround)))
    exchanged = light
    for _ in range(_ROUNDS):
        arriving = onto_patches @ source.astype(np.float32)
        emission = light.patch_emission + light.patch_reflectance * arriving
        near, exchanged = exchanged, changed.change(patch_emission=emission)
        smooth = surround + from_patches @ exchanged.patch_radiance(near).astype(np.float32) + between @ source
        before, source = source, sigma * albedo * (from_lamps + smooth)
        if np.abs(source - before).max() <= _SETTLED * source.max():
            break
    onto_fragments = _between_patches(transport, onto_patches @ source.astype(np.float32))
    hazy_light = exchanged.change(
        fragment_emission=light.fragment_emission + light.fragment_reflectance * onto_fragments
    )
    scattered = albedo * sigma * _towards_camera(light, air, smooth, sigma)
    picture = hazy_light.picture()
    added = picture * (np.exp(-sigma * air.depth) - 1) + np.moveaxis(scattered, -1, 0)
    return hazy_light.change(added=hazy_light.added + added)


def _attenuated(transport: PatchTransport, lamp_centres: list[NDArray], sigma: float) -> PatchTransport:
    """Transport whose exchange and direct light are attenuated; sigma in mm^-1."""
    field = transport.light
    centre = field.patches.centre

    def from_lamps(positions: NDArray) -> NDArray[np.float32]:
        ways = [np.linalg.norm(positions - lamp, axis=1) for lamp in lamp_centres]
        return np.exp(-sigma * np.stack(ways, axis=1)).astype(np.float32)

    exchange = replace(
        field.exchange,
        form_factors=field.exchange.form_factors * _passed(centre, centre, sigma),
        direct=field.exchange.direct * from_lamps(centre),
    )
    return replace(
        transport,
        light=replace(field, exchange=exchange),
        gather=_attenuated_gather(transport, sigma),
        direct=transport.direct * from_lamps(transport.position),
    )


def _attenuated_gather(transport: PatchTransport, sigma: float) -> csr_array:
    """G of the fragments, each entry times the share of the light that passes the air between."""
    clear = transport.gather
    gather = csr_array((clear.data.copy(), clear.indices, clear.indptr), shape=clear.shape)
    position = transport.position.astype(np.float32)
    centre = transport.light.patches.centre.astype(np.float32)
    for first in range(0, len(position), _FRAGMENTS):
        ends = gather.indptr[first : first + _FRAGMENTS + 1]
        start, stop = ends[0], ends[-1]
        square = np.zeros(stop - start, np.float32)
        for axis in range(3):  # by columns, in half the time of rows of three
            away = np.repeat(position[first : first + _FRAGMENTS, axis], np.diff(ends))
            away -= centre[gather.indices[start:stop], axis]
            square += away * away
        gather.data[start:stop] *= np.exp(np.float32(-sigma) * np.sqrt(square))
    return gather


def _passed(a: NDArray, b: NDArray, sigma: float) -> NDArray[np.float32]:
    """(n, m) transmittance of the air between points a (n, 3) and points b (m, 3), mm."""
    a, b = a.astype(np.float32), b.astype(np.float32)
    result = np.empty((len(a), len(b)), np.float32)
    squares = (b**2).sum(axis=1)
    for first in range(0, len(a), _ROWS):
        rows = a[first : first + _ROWS]
        block = np.matmul(rows, -2 * b.T, out=result[first : first + _ROWS])
        block += (rows**2).sum(axis=1)[:, None] + squares
        np.sqrt(np.maximum(block, 0, out=block), out=block)
        np.exp(np.multiply(block, np.float32(-sigma), out=block), out=block)
    return result


def _between_patches(transport: PatchTransport, values: NDArray) -> NDArray[np.float64]:
    """(f, w) values at the fragments from values (p, w) at patches of the same face.

    The nearest patches are weighted by the inverse square of their distance, at least 1 mm.
    """
    patches = transport.light.patches
    result = np.zeros((len(transport.face), values.shape[1]))
    for face in np.unique(transport.face):
        on_face, facing = transport.face == face, np.flatnonzero(patches.facet == face)
        neighbours = min(_NEIGHBOURS, len(facing))
        distance, nearest = KDTree(patches.centre[facing]).query(transport.position[on_face], neighbours)
        distance, nearest = distance.reshape(on_face.sum(), -1), nearest.reshape(on_face.sum(), -1)
        weight = 1 / np.maximum(distance, 1.0) ** 2
        weight /= weight.sum(axis=1, keepdims=True)
        result[on_face] = np.einsum("fk,fkw->fw", weight, values[facing[nearest]])
    return result


def _towards_camera(light: PatchLight, air: AirTransport, smooth: NDArray, sigma: float) -> NDArray[np.float64]:
    """(y, x, w) integral of the air's mean radiance along each ray, attenuated on its path.

    In mm times the radiance's unit. ``smooth`` (v, w) is the mean radiance without the direct light of the lamps, which
    is evaluated at every step because it varies fast.
    """
    eye = light.transport.camera.position_mm
    total = np.zeros((*air.depth.shape, smooth.shape[1]))
    length = air.depth / STEPS
    ways = [_way_from(lamp.centre, eye, air.direction) for lamp in air.lamps]
    for step in range(STEPS):
        along = (step + 0.5) * length
        direct = [lamp.rays[..., step] * np.exp(-sigma * way(along)) for lamp, way in zip(air.lamps, ways, strict=True)]
        radiance = air.at_step(step, smooth) + np.stack(direct, axis=-1) @ light.lamp_shares
        total += radiance * (np.exp(-sigma * along) * length)[..., None]
    return total


def _way_from(centre: NDArray, eye: NDArray, direction: NDArray) -> Callable[[NDArray], NDArray[np.float64]]:
    """Function of the distance (y, x) along each ray, mm, to the distance from a lamp's centre."""
    across = direction @ (eye - centre)
    square = float((eye - centre) @ (eye - centre))
    return lambda along: np.sqrt(np.maximum(along**2 + 2 * along * across + square, 0.0))


EFFECT = Effect(
    id="haze",
    stage="transport",
    title="the air scatters light",
    summary="The air scatters light equally in all directions, everywhere between camera and back wall. "
    "The parameters are the extinction per metre and the albedo of single scattering.",
    parameters=(
        Parameter("extinction_per_m", "m^-1", null=0.0, low=0.0, high=2.0, step=0.01),
        Parameter("albedo", "1", low=0.0, high=1.0, step=0.05, default=0.9),
    ),
    apply=_apply,
    confirm="Photograph a black trap near the camera and one at the back wall. Haze makes the far one brighter; "
    "glare in the lens makes both equally bright.",
    sources=(
        "Chandrasekhar, 'Radiative Transfer', 1950",
        "zones of gas and surface: Hottel and Sarofim, 'Radiative Transfer', 1967",
    ),
)
