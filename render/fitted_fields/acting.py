"""What a fitted field does at its stage of the chain, times an amplitude: 1 as found, 0 nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from cboxlab.scenes.scene import Lamp, Scene
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..chain import Counts, Light, Stage
from ..effects import Effect, Parameter
from ..perturbation import PatchLight
from .exchange import exchanges
from .fitted_field import Acts, FittedField
from .levels import parts_of_levels

__all__ = ["AMPLITUDE", "field_effect"]

AMPLITUDE = Parameter("amplitude", "1", null=0.0, low=-5.0, high=5.0, step=0.02, default=1.0)

#: Step of the camera by which displacements are found, px.
_STEP_PX = 0.05

_STAGES: dict[Acts, Stage] = {
    "offset": "counts",
    "levels": "counts",
    "gain": "counts",
    "previous": "counts",
    "displacement": "optics",
    "neighbours": "optics",
    "moments": "optics",
    "halo": "optics",
    "streak": "optics",
    "lamp": "scene",
    "reflectance": "transport",
    "irradiance": "transport",
    "radiance": "transport",
    "front": "transport",
}


def field_effect(name: str, field: FittedField, title: str, summary: str) -> Effect:
    """The effect of a field, with one parameter, the amplitude."""
    acting: Mapping[Stage, Callable[..., Any]] = {
        "counts": _on_counts,
        "optics": _on_light,
        "scene": _on_scene,
        "transport": _on_surfaces,
    }
    stage = _STAGES[field.acts]
    return Effect(
        id=name,
        stage=stage,
        title=title,
        summary=summary,
        parameters=(AMPLITUDE,),
        apply=partial(acting[stage], field, name),
        confirm="Take the scene again: a cause fixed in the box or on the sensor has the same amplitude there.",
        acts_on_charge=field.acts in ("gain", "previous"),
    )


def _images(field: FittedField, name: str, shape: tuple[int, int], rows: list[int]) -> NDArray[np.float64]:
    """(band, times, y, x) the maps' sums; ``rows`` are the field's bands. Raises InputError for another size."""
    if field.image is None:
        raise TypeError("a field on the sensor has maps")
    if shape != field.size:
        found, expected = (f"{size[1]} x {size[0]} px" for size in (shape, field.size))
        raise InputError(f"effect {name}", f"a picture of {found}", f"{expected}, for which it was fitted")
    each = [field.image.at(field.nm[row]) for row in rows]
    matrices = {maps: maps.matrix(shape) for maps in set(each)}
    own = zip(_coefficients(field)[rows], each, strict=True)
    sums = [part.reshape(-1, matrices[maps].shape[0]) @ matrices[maps] for part, maps in own]
    return np.array(sums).reshape(len(rows), -1, *shape)


def _coefficients(field: FittedField) -> NDArray[np.float64]:
    if field.coefficients is None:
        raise TypeError("a field on the sensor has coefficients")
    return field.coefficients


def _on_counts(field: FittedField, name: str, counts: Counts, amplitude: float) -> Counts:
    missing = [band for band in counts.bands if band not in field.bands]
    if missing:
        raise InputError(f"effect {name}", f"band '{missing[0]}'", f"one of {', '.join(field.bands)}")
    rows, columns = counts.scene.shape[1:]
    own = [field.bands.index(band) for band in counts.bands]
    dark = counts.dark_scene[:, None, None]
    if field.acts == "previous":
        parts = _coefficients(field)[np.ix_(own, own)]
        return replace(counts, scene=counts.scene + amplitude * np.tensordot(parts, counts.scene - dark, 1))
    if field.acts == "levels":
        each = zip(_coefficients(field)[own], counts.scene - dark, strict=True)
        added = [part @ parts_of_levels(one.ravel(), field.most_dn) for part, one in each]
        return replace(counts, scene=counts.scene + amplitude * np.reshape(added, counts.scene.shape))
    change = amplitude * _images(field, name, (rows, columns), own)[:, 0]
    if field.acts == "offset":
        return replace(counts, scene=counts.scene + change)
    return replace(counts, scene=dark + (1 + change) * (counts.scene - dark))


def _nearest(field: FittedField, nm: NDArray[np.float64]) -> list[int]:
    """Of each wavelength, the field's band next to it."""
    return [int(np.argmin(np.abs(field.nm - one))) for one in nm]


def _on_light(field: FittedField, name: str, light: Light, amplitude: float) -> Light:
    rows, columns = light.signal.shape[1:]
    fields = _images(field, name, (rows, columns), _nearest(field, light.effective_nm))
    if field.acts == "displacement":
        change = np.sum(np.moveaxis(fields, 1, 0) * _moved(light), axis=0)
    else:
        exchanged = np.array([exchanges(field.acts, image, field.radius, field.angle_deg) for image in light.signal])
        change = np.sum(fields * exchanged, axis=1)
    return light.with_signal(light.signal + amplitude * change)


def _moved(light: Light) -> NDArray[np.float64]:
    """(2, band, y, x) DN per px that the picture moves to the right and down."""
    if light.moved is None:
        down, right = np.gradient(light.signal, axis=(1, 2))
        return -np.array([right, down])
    u, v = light.camera.principal_point_px
    found = []
    for way in ((_STEP_PX, 0.0), (0.0, _STEP_PX)):
        ends = [
            light.moved(replace(light.camera, principal_point_px=np.array([u + sign * way[0], v + sign * way[1]])))
            for sign in (1, -1)
        ]
        found.append((ends[0] - ends[1]) / (2 * _STEP_PX))
    return np.array(found)


def _spectrum(field: FittedField, nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """(w,) what was found in the band next to each wavelength: between the bands nothing is known."""
    if field.spectrum is None:
        raise TypeError("a field of the scene has a spectrum")
    return np.asarray(field.spectrum[_nearest(field, nm)])


def _on_scene(field: FittedField, _: str, scene: Scene, amplitude: float) -> Scene:
    """The lamps' tables, sampled every 1 nm beside their own samples."""

    def changed(lamp: Lamp) -> Lamp:
        table = lamp.radiance
        inside = (table.wavelength_nm[0] <= WAVELENGTH_NM) & (table.wavelength_nm[-1] >= WAVELENGTH_NM)
        grid = np.union1d(table.wavelength_nm, WAVELENGTH_NM[inside])
        factor = np.maximum(1 + amplitude * _spectrum(field, grid), 0.0)
        return replace(lamp, radiance=Spectrum(grid, table.at(grid) * factor, table.outside))

    return scene.with_lamps(changed)


def _on_surfaces(field: FittedField, name: str, light: PatchLight, amplitude: float) -> PatchLight:
    patches, fragments = _values(field, name, light)
    spectrum = _spectrum(field, light.wavelength_nm)
    reflectance = light.fragment_reflectance
    if field.acts == "front":
        hidden = amplitude * fragments
        return light.change(
            fragment_reflectance=reflectance * (1 - hidden),
            fragment_emission=light.fragment_emission * (1 - hidden) + hidden * spectrum,
        )
    change = amplitude * fragments * spectrum
    if field.acts == "radiance":
        return light.change(fragment_emission=light.fragment_emission + change)
    on_patches = amplitude * patches * spectrum
    if field.acts == "irradiance":
        return light.change(
            fragment_emission=light.fragment_emission + reflectance * change,
            patch_emission=light.patch_emission + light.patch_reflectance * on_patches,
        )
    return light.change(
        fragment_reflectance=np.maximum(reflectance * (1 + change), 0.0),
        patch_reflectance=np.maximum(light.patch_reflectance * (1 + on_patches), 0.0),
    )


def _values(field: FittedField, name: str, light: PatchLight) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(p, w), (f, w) the maps' values. Raises InputError for a surface that the scene lacks."""
    transport, patches = light.transport, light.transport.light.patches
    known = [surface.name for surface in light.scene.surfaces]
    shapes = ((len(patches), len(light.wavelength_nm)), (len(transport.pixel), len(light.wavelength_nm)))
    on_patches, on_fragments = (np.zeros(shape) for shape in shapes)
    nearest = _nearest(field, light.wavelength_nm)
    for one in field.surfaces:
        if one.surface not in known:
            raise InputError(f"effect {name}", f"surface '{one.surface}'", f"one of {', '.join(known)}")
        index = known.index(one.surface)
        here, there = transport.surface == index, patches.surface == index
        own = np.ones(len(nearest)) if one.spectrum is None else one.spectrum[nearest]
        on_fragments[here] += np.outer(one.at(transport.position[here]), own)
        on_patches[there] += np.outer(one.over_patches(patches.centre[there], transport.position[here]), own)
    return on_patches, on_fragments
