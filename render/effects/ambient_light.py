"""Ambient light: light of the room enters through the open front.

A uniform surround of spectral radiance ``radiance`` S(lambda) / S(550 nm) is visible through the open front and past
the box's front edges. It lights the surfaces, and the camera sees it next to the box.

Parameters: radiance at 550 nm, W m^-2 sr^-1 nm^-1, null value 0; spectrum S of daylight, tungsten or fluorescent light.
Sources: Planck's law at 6500 K and 2900 K; Gaussian lines of a triphosphor lamp at 436, 488, 545 and 611 nm.
"""

from __future__ import annotations

import numpy as np
from cboxlab.scenes.spectra import planck

from ..perturbation import PatchLight
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


#: Lines of a triphosphor lamp: centre (nm), height over the continuum's 0.35 and standard deviation (nm).
_LINES = ((436.0, 1.0, 5.0), (488.0, 0.6, 7.0), (545.0, 2.2, 6.0), (611.0, 1.6, 7.0))


def _fluorescent(wavelength_nm: np.ndarray) -> np.ndarray:
    """Relative spectral radiance of a triphosphor lamp: a continuum of 0.35 and four lines."""
    bells = [h * np.exp(-0.5 * ((wavelength_nm - c) / s) ** 2) for c, h, s in _LINES]
    return 0.35 + np.sum(bells, axis=0)


def _spectrum(name: str, wavelength_nm: np.ndarray) -> np.ndarray:
    """Relative spectral radiance, 1 at 550 nm."""
    if name == "fluorescent":
        return _fluorescent(wavelength_nm) / _fluorescent(np.array(550.0))
    return planck(wavelength_nm, {"daylight": 6500.0, "tungsten": 2900.0}[name])


def _apply(light: PatchLight, radiance: float, spectrum: str) -> PatchLight:
    level = light.over_lamp(radiance * _spectrum(spectrum, light.grid_nm))
    return light.change(surround=light.surround + level)


EFFECT = Effect(
    id="ambient-light",
    stage="transport",
    title="light of the room enters through the open front",
    summary="Light of the room enters through the open front: a uniform surround of the given spectral radiance at "
    "550 nm. The camera also sees it past the box's front edges.",
    parameters=(
        Parameter("radiance", "W m^-2 sr^-1 nm^-1", null=0.0, low=0.0, high=1.0, step=1e-7),
        Parameter("spectrum", choices=("daylight", "tungsten", "fluorescent")),
    ),
    apply=_apply,
    confirm="Take one more frame of every band with the lamp off: its signal above dark is ambient light.",
    spectral_step_nm=5,
    sources=(
        "Planck's law at 6500 K and 2900 K",
        "Gaussian lines of a triphosphor lamp at 436, 488, 545, 611 nm",
    ),
)
