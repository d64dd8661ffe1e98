"""Lamp spectrum: the lamp's colour temperature differs from that of its table.

L' is proportional to L exp(-(c2 / lambda) m 1e-6), with c2 = h c / k and the mean over 400 to 700 nm kept. By Wien's
approximation this is a change of 1 / T by m per megakelvin. The cause is another voltage or age of the lamp.

Parameters: mired_shift m, MK^-1, null value 0; positive is redder.
Source: Wien's approximation of Planck's law.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM

from .effect import Effect, Parameter

__all__ = ["EFFECT"]

#: Second radiation constant h c / k, m K (CODATA 2018).
C2_M_K = 0.014387769


def _apply(scene: Scene, mired_shift: float) -> Scene:
    return scene.with_lamps(lambda lamp: replace(lamp, radiance=_tilted(lamp.radiance, mired_shift)))


def _tilted(table: Spectrum, mired_shift: float) -> Spectrum:
    """Spectrum times Wien's factor, its mean over 400 to 700 nm kept.

    The factor is sampled every 1 nm, and at the wavelengths of the table. A lamp without radiance there is not scaled.
    """
    inside = (table.wavelength_nm[0] <= WAVELENGTH_NM) & (table.wavelength_nm[-1] >= WAVELENGTH_NM)
    grid = np.union1d(table.wavelength_nm, WAVELENGTH_NM[inside])
    # relative to 550 nm, so that no exponential overflows; the scale to the same mean removes that factor
    tilt = np.exp(-C2_M_K * (1e9 / grid - 1e9 / 550.0) * mired_shift * 1e-6)
    tilted = Spectrum(grid, table.at(grid) * tilt, table.outside)
    weights = INTEGRAL_GRID.weights
    before, after = (float(weights @ spectrum.at(WAVELENGTH_NM)) for spectrum in (table, tilted))
    return tilted.scaled(before / after if after else 1.0)


EFFECT = Effect(
    id="lamp-spectrum",
    stage="scene",
    title="the lamp is redder or bluer than its table",
    summary="The lamp's colour temperature differs: radiance times exp(-(c2 / lambda) mired_shift 1e-6). "
    "The mean over 400 to 700 nm is kept; a positive shift is redder.",
    parameters=(Parameter("mired_shift", "MK^-1", null=0.0, low=-150.0, high=150.0, step=1.0),),
    apply=_apply,
    confirm="Measure the lamp's spectrum again at the capture's voltage and age; a lower voltage shifts it "
    "to the red. In the photograph, all surfaces show the same slope of the difference against wavelength.",
    sources=("Wien's approximation of Planck's law: a change of 1/T by m changes ln L by -(c2 / lambda) m",),
)
