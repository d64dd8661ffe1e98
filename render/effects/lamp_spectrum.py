"""Lamp spectrum: the lamp's colour temperature differs from that of its table."""

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
    """The tilt is taken every 1 nm beside the table's own samples. A lamp dark there keeps no mean."""
    inside = (table.wavelength_nm[0] <= WAVELENGTH_NM) & (table.wavelength_nm[-1] >= WAVELENGTH_NM)
    grid = np.union1d(table.wavelength_nm, WAVELENGTH_NM[inside])
    # Relative to 550 nm, which the norm takes out again, so that no exponential overflows.
    tilt = np.exp(-C2_M_K * (1e9 / grid - 1e9 / 550.0) * mired_shift * 1e-6)
    tilted = Spectrum(grid, table.at(grid) * tilt, table.outside)
    weights = INTEGRAL_GRID.weights
    before, after = (float(weights @ spectrum.at(WAVELENGTH_NM)) for spectrum in (table, tilted))
    return tilted.scaled(before / after if after else 1.0)


EFFECT = Effect(
    id="lamp-spectrum",
    stage="scene",
    title="the lamp is redder or bluer than its table",
    summary="The lamp's colour temperature differs: radiance times exp(-(c2 / lambda) mired_shift 1e-6), "
    "mean over 400 to 700 nm kept; positive is redder.",
    parameters=(Parameter("mired_shift", "MK^-1", null=0.0, low=-150.0, high=150.0, step=1.0),),
    apply=_apply,
    confirm="Measure the lamp's spectrum again at the capture's voltage and age; a lower voltage shifts it "
    "to the red. Bands of a white surface next to the lamp show the same slope against wavelength as every "
    "other surface.",
    sources=("Wien's approximation of Planck's law: a change of 1/T by m changes ln L by -(c2 / lambda) m",),
)
