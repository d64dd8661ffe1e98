"""Effects of fitted fields: the change at their stage of the chain, times an amplitude.

At amplitude 1 the change is the fitted one, at 0 there is none.
"""

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

from ..chain import Counts, Light, Stage, with_charge_moved
from ..effects import Effect, Parameter
from ..perturbation import PatchLight
from .exchange import exchanges
from .fitted_field import Acts, FittedField
from .levels import parts_of_levels

__all__ = ["AMPLITUDE", "field_effect"]

#: The one parameter of a fitted field: 0 is its null value, 1 the fitted strength.
AMPLITUDE = Parameter("amplitude", "1", null=0.0, low=-5.0, high=5.0, step=0.02, default=1.0)

#: Shift of the camera, px, whose difference quotient is the change of the picture per px: small against a pixel.
_STEP_PX = 0.05

#: Stage of the chain at which a field acts.
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
    "trail": "optics",
    "copy": "optics",
    "leak": "counts",
    "register": "counts",
    "lamp": "scene",
    "reflectance": "transport",
    "irradiance": "transport",
    "radiance": "transport",
    "front": "transport",
}


def field_effect(name: str, field: FittedField, title: str, summary: str) -> Effect:
    """Effect of a field, with the amplitude as its only parameter.

    Parameters
    ----------
    name
        Identifier of the effect.
    field
        The fitted field.
    title
        Description for lists, at most 50 characters; empty for the beginning of the summary.
    summary
        Description for users.

    Returns
    -------
    Effect
        The effect. Its function raises InputError for a picture of another size, or a band or surface that the field
        does not have.
    """
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
        confirm="Take the scene again: a cause fixed in the box or on the sensor has the same amplitude then.",
        acts_on_charge=field.acts in ("gain", "previous", "leak", "register"),
    )


def _images(field: FittedField, name: str, shape: tuple[int, int], rows: list[int]) -> NDArray[np.float64]:
    """(band, uses, y, x) sums of the maps in the field's bands ``rows``; see ``number_of_uses``.

    Raises
    ------
    InputError
        If the picture has another size than the field.
    """
    if field.image is None:
        raise TypeError("a field on the sensor has maps")
    if shape != field.size:
        actual, expected = (f"{size[1]} x {size[0]} px" for size in (shape, field.size))
        raise InputError(f"effect {name}", f"a picture of {actual}", f"{expected}, for which it was fitted")
    maps_by_band = [field.image.at(field.nm[row]) for row in rows]
    matrices = {maps: maps.matrix(shape) for maps in set(maps_by_band)}
    pairs = zip(_coefficients(field)[rows], maps_by_band, strict=True)
    sums = [part.reshape(-1, matrices[maps].shape[0]) @ matrices[maps] for part, maps in pairs]
    return np.array(sums).reshape(len(rows), -1, *shape)


def _coefficients(field: FittedField) -> NDArray[np.float64]:
    """(band, k) coefficients, which every field on the sensor has."""
    if field.coefficients is None:
        raise TypeError("a field on the sensor has coefficients")
    return field.coefficients


def _on_counts(field: FittedField, name: str, counts: Counts, amplitude: float) -> Counts:
    """Counts changed by a field on the sensor.

    Where charge moves, flats and reference change as well.
    """
    missing = [band for band in counts.bands if band not in field.bands]
    if missing:
        raise InputError(f"effect {name}", f"band '{missing[0]}'", f"one of {', '.join(field.bands)}")
    rows, columns = counts.scene.shape[1:]
    indices = [field.bands.index(band) for band in counts.bands]
    dark = counts.dark_scene[:, None, None]
    if field.acts == "previous":
        mixed = _images(field, name, (rows, columns), indices)[:, indices] * (counts.scene - dark)
        return replace(counts, scene=counts.scene + amplitude * mixed.sum(axis=1))
    if field.acts == "levels":
        pairs = zip(_coefficients(field)[indices], counts.scene - dark, strict=True)
        added = [part @ parts_of_levels(frame.ravel(), field.most_dn) for part, frame in pairs]
        return replace(counts, scene=counts.scene + amplitude * np.reshape(added, counts.scene.shape))
    if field.acts in ("leak", "register"):
        fields = amplitude * _images(field, name, (rows, columns), indices)
        return with_charge_moved(counts, partial(_exchanged, field, fields))
    change = amplitude * _images(field, name, (rows, columns), indices)[:, 0]
    if field.acts == "offset":
        return replace(counts, scene=counts.scene + change)
    return replace(counts, scene=dark + (1 + change) * (counts.scene - dark))


def _exchanged(field: FittedField, fields: NDArray[np.float64], frames: NDArray[np.float64]) -> NDArray[np.float64]:
    """(band, y, x) change of raw frames above dark by exchanges.

    fields : (band, uses, y, x) strength of each.
    """
    each = [exchanges(field.acts, frame, angle_deg=field.angle_deg) for frame in frames]
    return np.asarray(np.sum(fields * np.array(each), axis=1))


def _nearest(field: FittedField, nm: NDArray[np.float64]) -> list[int]:
    """Index of the field's band nearest to each wavelength."""
    return [int(np.argmin(np.abs(field.nm - wavelength))) for wavelength in nm]


def _on_light(field: FittedField, name: str, light: Light, amplitude: float) -> Light:
    """Light on the pixels changed by displacements, or by light that pixels exchange."""
    rows, columns = light.signal.shape[1:]
    fields = _images(field, name, (rows, columns), _nearest(field, light.effective_nm))
    if field.acts == "displacement":
        change = np.sum(np.moveaxis(fields, 1, 0) * _change_per_px(light), axis=0)
    else:
        exchanged = np.array(
            [exchanges(field.acts, image, field.radius, field.angle_deg, field.picture_copy) for image in light.signal]
        )
        change = np.sum(fields * exchanged, axis=1)
    return light.with_signal(light.signal + amplitude * change)


def _change_per_px(light: Light) -> NDArray[np.float64]:
    """(2, band, y, x) change of the picture, DN, per px of motion to the right and down."""
    if light.moved is None:
        down, right = np.gradient(light.signal, axis=(1, 2))
        return -np.array([right, down])
    u, v = light.camera.principal_point_px
    changes = []
    for step in ((_STEP_PX, 0.0), (0.0, _STEP_PX)):
        ends = [
            light.moved(replace(light.camera, principal_point_px=np.array([u + sign * step[0], v + sign * step[1]])))
            for sign in (1, -1)
        ]
        changes.append((ends[0] - ends[1]) / (2 * _STEP_PX))
    return np.array(changes)


def _spectrum(field: FittedField, nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """(w,) the field's spectrum at wavelengths ``nm``: that of the nearest band.

    It is not interpolated, because nothing was measured between the bands.
    """
    if field.spectrum is None:
        raise TypeError("a field of the scene has a spectrum")
    return np.asarray(field.spectrum[_nearest(field, nm)])


def _on_scene(field: FittedField, _: str, scene: Scene, amplitude: float) -> Scene:
    """Scene with the lamps' radiance scaled by the field.

    The factor is sampled every 1 nm, and at the wavelengths of the tables.
    """

    def changed(lamp: Lamp) -> Lamp:
        table = lamp.radiance
        inside = (table.wavelength_nm[0] <= WAVELENGTH_NM) & (table.wavelength_nm[-1] >= WAVELENGTH_NM)
        grid = np.union1d(table.wavelength_nm, WAVELENGTH_NM[inside])
        factor = np.maximum(1 + amplitude * _spectrum(field, grid), 0.0)
        return replace(lamp, radiance=Spectrum(grid, table.at(grid) * factor, table.outside))

    return scene.with_lamps(changed)


def _on_surfaces(field: FittedField, name: str, light: PatchLight, amplitude: float) -> PatchLight:
    """Light on patches and fragments changed by a field on surfaces."""
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
    """Maps' values on patches (p, w) and fragments (f, w); InputError for an unknown surface."""
    transport, patches = light.transport, light.transport.light.patches
    names = [surface.name for surface in light.scene.surfaces]
    shapes = ((len(patches), len(light.wavelength_nm)), (len(transport.pixel), len(light.wavelength_nm)))
    on_patches, on_fragments = (np.zeros(shape) for shape in shapes)
    nearest = _nearest(field, light.wavelength_nm)
    for surface_map in field.surfaces:
        if surface_map.surface not in names:
            raise InputError(f"effect {name}", f"surface '{surface_map.surface}'", f"one of {', '.join(names)}")
        index = names.index(surface_map.surface)
        fragment, patch = transport.surface == index, patches.surface == index
        spectrum = np.ones(len(nearest)) if surface_map.spectrum is None else surface_map.spectrum[nearest]
        position = transport.position[fragment]
        on_fragments[fragment] += np.outer(surface_map.at(position), spectrum)
        on_patches[patch] += np.outer(surface_map.over_patches(patches.centre[patch], position), spectrum)
    return on_patches, on_fragments
