"""Effects that the catalogue does not hold, for blind practice: what a diagnosis must answer with `unknown`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.rendering.chain import BandCurves, Counts
from cboxlab.rendering.chain.light import Light
from cboxlab.rendering.effects import Effect, Parameter
from cboxlab.scenes.scene import Scene, Surface
from cboxlab.scenes.shapes import box_mesh
from cboxlab.scenes.spectra import Spectrum
from numpy.typing import NDArray

__all__ = ["COLOUR_SENSOR", "KEPT_BACK", "NEIGHBOURS", "OUTSIDE"]


def _position(light: Light) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(y, x) row and column, 0 to 1 over the image."""
    rows, columns = np.indices(light.signal.shape[1:])
    return rows / light.signal.shape[1], columns / light.signal.shape[2]


#: Surfaces that are no thing in the room.
_ROOM = {"floor", "ceiling", "back", "left", "right"}


def _stain(light: Light, amount: float, row: float, column: float) -> Light:
    v, u = _position(light)
    spot = np.exp(-((v - row) ** 2 + (u - column) ** 2) / (2 * 0.05**2))
    return light.with_signal(light.signal * (1 - amount * spot))


def _fringes(light: Light, amount: float, row: float, column: float) -> Light:
    v, u = _position(light)
    waves = 6 + 10 * row
    return light.with_signal(light.signal * (1 + amount * np.sin(2 * np.pi * waves * (v + column * u))))


def _seam(light: Light, amount: float, row: float, column: float) -> Light:
    """Light of the room through a seam between two walls."""
    _, u = _position(light)
    mean = np.median(light.signal, axis=(1, 2))[:, None, None]
    return light.with_signal(light.signal + amount * mean * np.exp(-np.abs(u - 0.2 - 0.6 * column) / 0.03))


def _corner_glow(light: Light, amount: float, row: float, column: float) -> Light:
    """An amplifier that glows at a corner of the sensor."""
    v, u = _position(light)
    away = np.hypot(v - round(row), u - round(column))
    mean = np.median(light.signal, axis=(1, 2))[:, None, None]
    return light.with_signal(light.signal + amount * mean * np.exp(-away / 0.15))


def _halo(light: Light, amount: float, row: float, column: float) -> Light:
    """Scatter in the lens that falls with the distance from bright places."""
    from scipy.ndimage import gaussian_filter

    wide = gaussian_filter(light.signal, (0, 8, 8), mode="nearest")
    return light.with_signal((1 - amount) * light.signal + amount * wide)


def _motion_blur(light: Light, amount: float, row: float, column: float) -> Light:
    """The camera shook along one line while the shutter was open."""
    from scipy.ndimage import shift

    step = (0.0, np.sin(np.pi * row), np.cos(np.pi * row))
    sides = sum(shift(light.signal, np.multiply(sign, step), order=1, mode="nearest") for sign in (-1, 1))
    return light.with_signal((1 - amount) * light.signal + amount / 2 * sides)


def _tilted_sensor(light: Light, amount: float, row: float, column: float) -> Light:
    """Sharp on one side of the image only."""
    from scipy.ndimage import gaussian_filter

    _, u = _position(light)
    share = amount * np.abs(u - round(column)) ** 2
    return light.with_signal(
        (1 - share) * light.signal + share * gaussian_filter(light.signal, (0, 0.8, 0.8), mode="nearest")
    )


def _row_bands(light: Light, amount: float, row: float, column: float) -> Light:
    """Every few rows another reader, with another gain."""
    rows = np.arange(light.signal.shape[1])
    gain = 1 + amount * np.sin(2 * np.pi * rows / (2 + round(6 * row)) + column)
    return light.with_signal(light.signal * gain[:, None])


def _forgotten_cube(scene: Scene, amount: float, row: float, column: float) -> Scene:
    """Somebody left a cube on the floor, of up to 100 mm, in the floor's paint."""
    edge = 1 + 99 * amount
    centre = np.array([330 + 130 * column, edge / 2 + 0.2, 60 + 90 * row])
    cube = Surface("forgotten", scene.surface("floor").material, *box_mesh(centre, np.full(3, edge), 90 * row))
    return replace(scene, surfaces=(*scene.surfaces, cube))


def _repainted(scene: Scene, amount: float, row: float, column: float) -> Scene:
    """One thing in the room wears another paint than the rest: darker in the blue."""
    objects = [s for s in scene.surfaces if s.name not in _ROOM]
    surface = objects[min(int(row * len(objects)), len(objects) - 1)]
    old = scene.materials[surface.material]
    wavelength = np.asarray(old.reflectance.wavelength_nm)
    bent = np.asarray(old.reflectance.values) * (1 - amount * np.exp(-(((wavelength - 460) / 60) ** 2)))
    new = replace(old, name="other", reflectance=Spectrum(wavelength, np.clip(bent, 0, 1)))
    surfaces = tuple(replace(s, material="other") if s is surface else s for s in scene.surfaces)
    return replace(scene, surfaces=surfaces, materials={**scene.materials, "other": new})


def _red_leak(light: Light, amount: float, row: float, column: float) -> Light:
    """The two bluest filters pass light beyond the reddest band, where paints differ less, or more."""
    far = light.signal[-1] / light.signal[-1].mean()
    leak = amount * light.signal.mean(axis=(1, 2))[:, None, None] * far ** (0.5 + row)
    share = np.zeros(len(leak))
    share[:2] = 1.0, column
    return light.with_signal(light.signal + share[:, None, None] * leak)


def _hot_pixels(light: Light, amount: float, row: float, column: float) -> Light:
    """Four of a thousand pixels count too much, each by another amount."""
    draw, shape = np.random.default_rng(int(1e6 * row)), light.signal.shape[1:]
    hot = np.where(draw.random(shape) < 0.004, draw.exponential(1.0, shape), 0.0)
    return light.with_signal(light.signal + 20 * amount * hot * np.median(light.signal, axis=(1, 2))[:, None, None])


def _sensor_dust(light: Light, amount: float, row: float, column: float) -> Light:
    """Seven soft shadows of dust that came to the sensor after the flats."""
    from scipy.ndimage import gaussian_filter

    draw, (v, u) = np.random.default_rng(int(1e6 * row)), _position(light)
    shadow = np.zeros_like(v)
    for _ in range(7):
        centre, radius, depth = draw.uniform(0.05, 0.95, 2), draw.uniform(0.015, 0.035), draw.uniform(0.3, 1.0)
        shadow += depth * (np.hypot(v - centre[0], u - centre[1]) < radius)
    return light.with_signal(light.signal * (1 - 10 * amount * gaussian_filter(shadow, 0.7)))


def _shiny_plate(light: Light, amount: float, row: float, column: float) -> Light:
    """A thin shiny plate on the floor mirrors what the picture shows above it."""
    height, width = light.signal.shape[1:]
    top, deep = int((0.8 + 0.08 * row) * height), max(int(0.08 * height), 3)
    first = int((0.15 + 0.5 * column) * width)
    columns = slice(first, first + width // 5)
    signal = light.signal.copy()
    mirrored = signal[:, top - deep : top, columns][:, ::-1]
    signal[:, top : top + deep, columns] += 5 * amount * mirrored
    return light.with_signal(signal)


def _band_fringes(light: Light, amount: float, row: float, column: float) -> Light:
    """Rings of interference in one filter."""
    (v, u), signal = _position(light), light.signal.copy()
    away = np.hypot(v - 0.3 - 0.4 * column, u - 0.5)
    signal[int(row * len(signal))] *= 1 + 5 * amount * np.sin(2 * np.pi * (25 * away**2 + 8 * column))
    return light.with_signal(signal)


def _second_lamp(scene: Scene, amount: float, row: float, column: float) -> Scene:
    """A small lamp of the same kind burns near the front edge of the ceiling."""
    lamp = scene.lamp
    corners = lamp.surface.vertices_mm
    middle = corners.mean(axis=0)
    centre = np.array([100 + 350 * column, middle[1], 60 + 60 * row])
    surface = replace(lamp.surface, name="second-lamp", vertices_mm=0.3 * (corners - middle) + centre)
    radiance = replace(lamp.radiance, values=np.asarray(lamp.radiance.values) * 10 * amount)
    return replace(scene, further_lamps=(*scene.further_lamps, replace(lamp, surface=surface, radiance=radiance)))


def _leak_at(curves: BandCurves, band: int, amount: float, centre_nm: float, width_nm: float) -> BandCurves:
    """Curves with one filter that passes a second, wide range, on flats and reference too."""
    beyond = np.exp(-0.5 * ((curves.wavelength_nm - centre_nm) / width_nm) ** 2)
    transmittance = curves.transmittance.copy()
    transmittance[:, band] += amount * transmittance[:, band].max() * beyond
    return replace(curves, transmittance=transmittance)


def _far_leak(curves: BandCurves, amount: float, row: float, column: float) -> BandCurves:
    """One of the two bluest filters is not blocked beyond 660 nm."""
    return _leak_at(curves, int(2 * row), amount, 690 + 20 * column, 25)


def _blue_leak(curves: BandCurves, amount: float, row: float, column: float) -> BandCurves:
    """One of the two reddest filters has its second order in the blue."""
    return _leak_at(curves, len(curves.bands) - 1 - int(2 * row), amount, 410 + 40 * column, 15)


def _wrong_table(curves: BandCurves, amount: float, row: float, column: float) -> BandCurves:
    """One filter's pass band lies up to 20 nm off its table."""
    transmittance, band = curves.transmittance.copy(), 1 + int(row * (len(curves.bands) - 2))
    off = 20 * amount * np.sign(column - 0.5)
    for at_angle in transmittance:
        at_angle[band] = np.interp(curves.wavelength_nm - off, curves.wavelength_nm, at_angle[band])
    return replace(curves, transmittance=transmittance)


def _next_filter(light: Light, amount: float, row: float, column: float) -> Light:
    """The wheel stopped a little early in one frame of the scene: a part of the light came through its neighbour."""
    signal, band = light.signal.copy(), int(row * (len(light.signal) - 1))
    signal[band] = (1 - amount) * signal[band] + amount * signal[band + 1]
    return light.with_signal(signal)


def _along(image: NDArray[np.float64], steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of an image at several shifts (k, 2), px."""
    from scipy.ndimage import shift

    return np.mean([shift(image, step, order=3, mode="nearest") for step in steps], axis=0)


def _direction(row: float) -> NDArray[np.float64]:
    return np.array([np.sin(np.pi * row), np.cos(np.pi * row)])


def _shaken_frame(light: Light, amount: float, row: float, column: float) -> Light:
    """Somebody touched the table during one band."""
    signal, band = light.signal.copy(), int(column * len(light.signal))
    signal[band] = _along(signal[band], np.outer(np.linspace(-3, 3, 7) * amount, _direction(row)))
    return light.with_signal(signal)


def _vibration(light: Light, amount: float, row: float, column: float) -> Light:
    """A pump near the table: the camera swings along one line, longest at both ends."""
    swing = 3 * amount * np.cos(np.pi * (np.arange(8) + 0.5) / 8)
    return light.with_signal(np.array([_along(image, np.outer(swing, _direction(row))) for image in light.signal]))


def _sag(light: Light, amount: float, row: float, column: float) -> Light:
    """The tripod sinks while dark bands are exposed, which takes longer: down the picture, from rest to its end."""
    levels = np.median(light.signal, axis=(1, 2))
    long = levels.min() / levels
    swing = [np.outer(np.linspace(0, 4 * amount * part, 6), [1.0, 0.2 * column]) for part in long]
    return light.with_signal(
        np.array([_along(i, s - s.mean(axis=0)) for i, s in zip(light.signal, swing, strict=True)])
    )


def _double_exposure(light: Light, amount: float, row: float, column: float) -> Light:
    """The shutter opened a second time when the camera stood three pixels aside."""
    step = 3 * _direction(row)
    second = np.array([_along(image, step[None]) for image in light.signal])
    return light.with_signal((1 - amount) * light.signal + amount * second)


def _focus_drift(light: Light, amount: float, row: float, column: float) -> Light:
    """The lens warms up and loses its focus from band to band."""
    from scipy.ndimage import gaussian_filter

    widths = np.linspace(0, 2 * amount, len(light.signal)) + 1e-6
    return light.with_signal(
        np.array([gaussian_filter(i, w, mode="nearest") for i, w in zip(light.signal, widths, strict=True)])
    )


def _lines(light: Light, amount: float, row: float, column: float) -> Light:
    """The lens draws points as short lines along rows, or along columns."""
    from scipy.ndimage import gaussian_filter1d

    axis = 1 + round(row)
    return light.with_signal(gaussian_filter1d(light.signal, 2 * amount + 1e-6, axis=axis, mode="nearest"))


def _window(light: Light, amount: float, row: float, column: float) -> Light:
    """A pane before the lens mirrors the picture, left for right."""
    mirrored = np.roll(light.signal[:, :, ::-1], round(8 * (column - 0.5)), axis=2)
    return light.with_signal((1 - amount) * light.signal + amount * mirrored)


def _sideways(counts: Counts, amount: float, row: float, column: float) -> Counts:
    """Charge spreads along rows, or along columns, in every frame: other colours than those of four neighbours."""
    from scipy.ndimage import correlate1d

    weights, axis = np.array([amount / 2, 1 - amount, amount / 2]), 1 + round(row)
    spread = [
        correlate1d(frame, weights, axis=axis, mode="nearest")
        for frame in (counts.scene, counts.flat, counts.reference)
    ]
    return replace(counts, scene=spread[0], flat=spread[1], reference=spread[2])


def _other_rows(counts: Counts, amount: float, row: float, column: float) -> Counts:
    """Every second row counts more in frames of the scene: the two greens of a Bayer sensor are unlike."""
    signal = counts.scene - counts.dark_scene[:, None, None]
    second = np.arange(signal.shape[1]) % 2 == round(row)
    return replace(counts, scene=counts.scene + amount * signal * second[:, None])


def _column_pair(counts: Counts, amount: float, row: float, column: float) -> Counts:
    """Two columns that one amplifier reads count more in frames of the scene."""
    signal = counts.scene - counts.dark_scene[:, None, None]
    first = int(column * (signal.shape[2] - 2))
    pair = np.isin(np.arange(signal.shape[2]), (first, first + 1))
    return replace(counts, scene=counts.scene + 20 * amount * signal * pair)


def _one_way(counts: Counts, amount: float, row: float, column: float) -> Counts:
    """Charge of each pixel that stays behind for the next one of its register, in every frame."""
    axis, step = 1 + round(row), 1 if column > 0.5 else -1

    def after(frames: NDArray[np.float64], dark: NDArray[np.float64]) -> NDArray[np.float64]:
        charge = frames - dark[:, None, None]
        before = np.roll(charge, step, axis=axis)
        ends = [slice(None)] * 3
        ends[axis] = slice(0, 1) if step > 0 else slice(-1, None)
        before[tuple(ends)] = charge[tuple(ends)]
        return frames + amount * (before - charge)

    return replace(
        counts,
        scene=after(counts.scene, counts.dark_scene),
        flat=after(counts.flat, counts.dark_flat),
        reference=after(counts.reference, counts.dark_reference),
    )


def _in_place(counts: Counts, row: float, column: float) -> NDArray[np.bool_]:
    """(y, x) pixels of one place of a repeat of 2 x 2: one of the greens, or another channel."""
    rows, columns = np.indices(counts.scene.shape[1:])
    return (rows % 2 == round(row)) & (columns % 2 == round(column))


def _one_place(counts: Counts, amount: float, row: float, column: float) -> Counts:
    """Pixels of one place count more in frames of the scene: a green that differs from the other one."""
    signal = counts.scene - counts.dark_scene[:, None, None]
    return replace(counts, scene=counts.scene + amount * signal * _in_place(counts, row, column))


def _black_level(counts: Counts, amount: float, row: float, column: float) -> Counts:
    """Pixels of one place carry counts that the darks lack."""
    added = amount * 1000 * _in_place(counts, row, column)
    return replace(counts, scene=counts.scene + added, flat=counts.flat + added, reference=counts.reference + added)


def _bent_place(counts: Counts, amount: float, row: float, column: float) -> Counts:
    """The amplifier of one place bends: counts in all frames lack a part that grows with them."""
    bend = -amount * _in_place(counts, row, column) / counts.full_scale
    frames = [frame * (1 + bend * frame) for frame in (counts.scene, counts.flat, counts.reference)]
    return replace(counts, scene=frames[0], flat=frames[1], reference=frames[2])


def _quarter(counts: Counts, amount: float, row: float, column: float) -> Counts:
    """The amplifier of a quarter of the sensor has drifted."""
    height, width = counts.scene.shape[1:]
    rows, columns = np.indices((height, width))
    inside = (rows * 2 // height == round(row)) & (columns * 2 // width == round(column))
    signal = counts.scene - counts.dark_scene[:, None, None]
    return replace(counts, scene=counts.scene + amount * signal * inside)


def _deep_red(curves: BandCurves, amount: float, row: float, column: float) -> BandCurves:
    """All dyes pass light at the long end of the spectrum, about the same of it."""
    beyond = np.exp(-0.5 * ((curves.wavelength_nm - 685 - 10 * column) / 12) ** 2)
    plain = curves.rest.max(axis=0)
    return replace(curves, rest=curves.rest + amount * beyond * plain)


def _mixed_dyes(curves: BandCurves, amount: float, row: float, column: float) -> BandCurves:
    """Each dye passes a part of what the next passes: tables of another copy of the camera."""
    return replace(curves, rest=(1 - amount) * curves.rest + amount * np.roll(curves.rest, 1, axis=0))


def _halation(light: Light, amount: float, row: float, column: float) -> Light:
    """A halo about bright places in the channel that goes deepest into the silicon."""
    from scipy.ndimage import gaussian_filter

    signal = light.signal.copy()
    signal[0] = (1 - amount) * signal[0] + amount * gaussian_filter(signal[0], 2 + 2 * row, mode="nearest")
    return light.with_signal(signal)


def _effect(name: str, stage: str, apply: object) -> Effect:
    numbers = (
        Parameter("amount", null=0.0, low=0.0, high=1.0, step=1e-3),
        Parameter("row", low=0.0, high=1.0),
        Parameter("column", low=0.0, high=1.0),
    )
    return Effect(name, stage, "not in the catalogue", numbers, apply, "blind practice only")  # type: ignore[arg-type]


def _effects(*entries: tuple[str, str, Callable[..., Any]]) -> dict[str, Effect]:
    """Effects by name, of their names, stages and functions."""
    return {name: _effect(name, stage, apply) for name, stage, apply in entries}


OUTSIDE = _effects(
    ("stain", "optics", _stain),
    ("fringes", "optics", _fringes),
    ("seam", "optics", _seam),
    ("corner-glow", "optics", _corner_glow),
    ("halo", "optics", _halo),
    ("motion-blur", "optics", _motion_blur),
    ("tilted-sensor", "optics", _tilted_sensor),
    ("row-bands", "optics", _row_bands),
    ("forgotten-cube", "scene", _forgotten_cube),
    ("repainted-block", "scene", _repainted),
)

#: Causes that no decision constant was set with.
KEPT_BACK = _effects(
    ("red-leak", "optics", _red_leak),
    ("hot-pixels", "optics", _hot_pixels),
    ("sensor-dust", "optics", _sensor_dust),
    ("shiny-plate", "optics", _shiny_plate),
    ("band-fringes", "optics", _band_fringes),
    ("second-lamp", "scene", _second_lamp),
)

#: Causes close to effects of the catalogue: other leaks, other blurs, double exposures. No constant was set with them.
NEIGHBOURS = _effects(
    ("far-leak", "filter", _far_leak),
    ("blue-leak", "filter", _blue_leak),
    ("wrong-table", "filter", _wrong_table),
    ("next-filter", "optics", _next_filter),
    ("shaken-frame", "optics", _shaken_frame),
    ("vibration", "optics", _vibration),
    ("sag", "optics", _sag),
    ("double-exposure", "optics", _double_exposure),
    ("focus-drift", "optics", _focus_drift),
    ("lines", "optics", _lines),
    ("window", "optics", _window),
)

#: Causes that colour sensors have: behind a mosaic they go from colour to colour. No constant was set with them.
COLOUR_SENSOR = _effects(
    ("sideways-leak", "counts", _sideways),
    ("other-rows", "counts", _other_rows),
    ("column-pair", "counts", _column_pair),
    ("one-way-leak", "counts", _one_way),
    ("one-place", "counts", _one_place),
    ("black-level", "counts", _black_level),
    ("bent-place", "counts", _bent_place),
    ("quarter", "counts", _quarter),
    ("deep-red", "filter", _deep_red),
    ("mixed-dyes", "filter", _mixed_dyes),
    ("halation", "optics", _halation),
)
