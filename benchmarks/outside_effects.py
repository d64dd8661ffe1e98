"""Effects that the catalogue does not hold, for blind practice: what a diagnosis must answer with `unknown`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.spectra import Spectrum
from cboxlab.validate.effects import Effect, Light, Parameter
from numpy.typing import NDArray

__all__ = ["OUTSIDE"]


def _places(light: Light) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(y, x) row and column, 0 to 1 over the image."""
    rows, columns = np.indices(light.signal.shape[1:])
    return rows / light.signal.shape[1], columns / light.signal.shape[2]


def _stain(light: Light, amount: float, row: float, column: float) -> Light:
    v, u = _places(light)
    spot = np.exp(-((v - row) ** 2 + (u - column) ** 2) / (2 * 0.05**2))
    return light.with_signal(light.signal * (1 - amount * spot))


def _fringes(light: Light, amount: float, row: float, column: float) -> Light:
    v, u = _places(light)
    waves = 6 + 10 * row
    return light.with_signal(light.signal * (1 + amount * np.sin(2 * np.pi * waves * (v + column * u))))


def _seam(light: Light, amount: float, row: float, column: float) -> Light:
    """Light of the room through a seam between two walls."""
    _, u = _places(light)
    mean = np.median(light.signal, axis=(1, 2))[:, None, None]
    return light.with_signal(light.signal + amount * mean * np.exp(-np.abs(u - 0.2 - 0.6 * column) / 0.03))


def _corner_glow(light: Light, amount: float, row: float, column: float) -> Light:
    """An amplifier that glows at a corner of the sensor."""
    v, u = _places(light)
    away = np.hypot(v - round(row), u - round(column))
    mean = np.median(light.signal, axis=(1, 2))[:, None, None]
    return light.with_signal(light.signal + amount * mean * np.exp(-away / 0.15))


def _halo(light: Light, amount: float, row: float, column: float) -> Light:
    """Scatter in the lens that falls with the distance from bright places."""
    from scipy.ndimage import gaussian_filter

    wide = gaussian_filter(light.signal, (0, 8, 8), mode="nearest")
    return light.with_signal((1 - amount) * light.signal + amount * wide)


def _repainted(scene: Scene, amount: float, row: float, column: float) -> Scene:
    """One block wears another paint than the rest: lighter or darker in the blue."""
    surface = next(s for s in scene.surfaces if s.name == ("tall-block" if row > 0.5 else "short-block"))
    old = scene.materials[surface.material]
    wavelength = np.asarray(old.reflectance.wavelength_nm)
    bent = np.asarray(old.reflectance.values) * (1 - amount * np.exp(-(((wavelength - 460) / 60) ** 2)))
    new = replace(old, name="other", reflectance=Spectrum(wavelength, np.clip(bent, 0, 1)))
    surfaces = tuple(replace(s, material="other") if s is surface else s for s in scene.surfaces)
    return replace(scene, surfaces=surfaces, materials={**scene.materials, "other": new})


def _effect(name: str, stage: str, apply: object) -> Effect:
    numbers = (
        Parameter("amount", null=0.0, low=0.0, high=1.0, step=1e-3),
        Parameter("row", low=0.0, high=1.0),
        Parameter("column", low=0.0, high=1.0),
    )
    return Effect(name, stage, "not in the catalogue", numbers, apply, "blind practice only")  # type: ignore[arg-type]


OUTSIDE = {
    name: _effect(name, stage, apply)
    for name, stage, apply in (
        ("stain", "optics", _stain),
        ("fringes", "optics", _fringes),
        ("seam", "optics", _seam),
        ("corner-glow", "optics", _corner_glow),
        ("halo", "optics", _halo),
        ("repainted-block", "scene", _repainted),
    )
}
