"""Haze: the air scatters, everywhere between camera and back wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from ..perturbation import STEPS, AirTransport, PatchLight, PatchTransport, air_transport
from .effect import Effect, Parameter

__all__ = ["EFFECT"]

#: Light from the air onto a surface is interpolated from so many of the nearest patches.
_NEIGHBOURS = 4

#: Rounds of exchange between air and surfaces; each adds about extinction times path length of the one before. They
#: end before that where the air's light changes by less than a part of it.
_ROUNDS, _SETTLED = 6, 1e-5

#: Rows of a table of distances that are computed at once: their numbers stay in the processor's cache.
_ROWS = 64

#: Fragments whose distances to the patches that they see are computed at once.
_FRAGMENTS = 1024


def _apply(light: PatchLight, extinction_per_m: float, albedo: float) -> PatchLight:
    """Attenuation along every path; all orders of scattering between cells of air, patches and lamp."""
    if extinction_per_m == 0:
        return light
    sigma = extinction_per_m * 1e-3
    transport = light.transport
    patches = transport.light.patches
    air = air_transport(transport)
    hazy = _attenuated(transport, [lamp.centre for lamp in air.lamps], sigma)
    changed = light.change(transport=hazy)

    seen = air.seen * _passed(air.centres, patches.centre, sigma)
    # by reciprocity, from how much of each patch a cell of air sees
    onto_patches = 4 * (air.volume[:, None] * seen).T / patches.area[:, None]
    from_each = [lamp.cells * np.exp(-sigma * np.linalg.norm(air.centres - lamp.centre, axis=1)) for lamp in air.lamps]
    from_lamps = np.stack(from_each, axis=1) @ light.lamp_shares
    surround = np.outer(air.escape, light.surround)
    between = air.between_cells(sigma)
    source = np.zeros((len(air.volume), len(light.surround)))
    for _ in range(_ROUNDS):
        arriving = onto_patches @ source
        lit = changed.change(patch_emission=light.patch_emission + light.patch_reflectance * arriving)
        smooth = surround + seen @ lit.patch_radiance() + between @ source
        before, source = source, sigma * albedo * (from_lamps + smooth)
        if np.abs(source - before).max() <= _SETTLED * source.max():
            break
    onto_fragments = _between_patches(transport, onto_patches @ source)
    lit = lit.change(fragment_emission=light.fragment_emission + light.fragment_reflectance * onto_fragments)
    scattered = albedo * sigma * _towards_camera(light, air, smooth, sigma)
    picture = lit.picture()
    added = picture * (np.exp(-sigma * air.depth) - 1) + np.moveaxis(scattered, -1, 0)
    return lit.change(added=lit.added + added)


def _attenuated(transport: PatchTransport, lamp_centres: list[NDArray], sigma: float) -> PatchTransport:
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
    given = transport.gather
    gather = csr_array((given.data.copy(), given.indices, given.indptr), shape=given.shape)
    position = transport.position.astype(np.float32)
    centre = transport.light.patches.centre.astype(np.float32)
    for first in range(0, len(position), _FRAGMENTS):
        ends = gather.indptr[first : first + _FRAGMENTS + 1]
        start, stop = ends[0], ends[-1]
        away = np.repeat(position[first : first + _FRAGMENTS], np.diff(ends), axis=0)
        away -= centre[gather.indices[start:stop]]
        gather.data[start:stop] *= np.exp(np.float32(-sigma) * np.linalg.norm(away, axis=1))
    return gather


def _passed(a: NDArray, b: NDArray, sigma: float) -> NDArray[np.float32]:
    """(n, m) share of the light that passes from one of the points a (n, 3) to one of b (m, 3), mm."""
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
    """(f, w) at the fragments from (p, w) at the patches of the same face, nearer ones more."""
    patches = transport.light.patches
    result = np.zeros((len(transport.face), values.shape[1]))
    for face in np.unique(transport.face):
        own, here = transport.face == face, np.flatnonzero(patches.facet == face)
        distance, nearest = KDTree(patches.centre[here]).query(transport.position[own], min(_NEIGHBOURS, len(here)))
        distance, nearest = distance.reshape(own.sum(), -1), nearest.reshape(own.sum(), -1)
        weight = 1 / np.maximum(distance, 1.0) ** 2
        weight /= weight.sum(axis=1, keepdims=True)
        result[own] = np.einsum("fk,fkw->fw", weight, values[here[nearest]])
    return result


def _towards_camera(light: PatchLight, air: AirTransport, smooth: NDArray, sigma: float) -> NDArray[np.float64]:
    """(y, x, w) mean radiance in the air times path length, mm, attenuated on its path to the camera.

    smooth : (v, w) of it all that is not the lamps' own.
    """
    eye = light.transport.camera.position_mm
    total = np.zeros((*air.depth.shape, smooth.shape[1]))
    length = air.depth / STEPS
    for step in range(STEPS):
        along = (step + 0.5) * length
        point = eye + along[..., None] * air.direction
        lit = [
            lamp.rays[..., step] * np.exp(-sigma * np.linalg.norm(point - lamp.centre, axis=-1)) for lamp in air.lamps
        ]
        radiance = air.at(point, smooth) + np.stack(lit, axis=-1) @ light.lamp_shares
        total += radiance * (np.exp(-sigma * along) * length)[..., None]
    return total


EFFECT = Effect(
    id="haze",
    stage="transport",
    title="the air scatters light",
    summary="The air scatters, isotropically, everywhere between camera and back wall: extinction per metre, "
    "albedo of single scattering.",
    parameters=(
        Parameter("extinction_per_m", "m^-1", null=0.0, low=0.0, high=2.0, step=0.01),
        Parameter("albedo", "1", low=0.0, high=1.0, step=0.05, default=0.9),
    ),
    apply=_apply,
    confirm="Photograph a black trap near the camera and one at the back wall: haze makes the far one brighter, "
    "glare in the lens both alike.",
    sources=(
        "Chandrasekhar, 'Radiative Transfer', 1950",
        "zones of gas and surface: Hottel and Sarofim, 'Radiative Transfer', 1967",
    ),
)
