"""Fluorescence: one material absorbs short wavelengths and emits longer ones."""

from __future__ import annotations

import numpy as np
from cboxlab.scenes.wavelength_grid import trapezoidal_weights

from ..perturbation import PatchLight
from ..radiosity import solve
from .effect import Effect, Parameter, index_of

__all__ = ["EFFECT"]

_ABSORBED_BELOW_NM = 455.0
_STEP_NM = 5.0
_BELL_SIGMA_NM = 24.0

#: Where a search for the peak starts, nm.
_PEAKS_NM = (460.0, 500.0, 540.0, 580.0, 620.0, 660.0)


def _apply(light: PatchLight, material: str, peak_nm: float, **values: float) -> PatchLight:
    transport = light.transport
    scene = light.scene
    own = index_of(material, scene.materials, "fluorescence: material")
    wavelength = np.arange(light.grid_nm[0], _ABSORBED_BELOW_NM + 1e-6, _STEP_NM)
    lamp = np.interp(wavelength, light.grid_nm, light.lamp)
    shares = scene.lamp_shares(wavelength)
    table = scene.reflectances(wavelength)
    patch_material = transport.light.patches.material
    exchange = transport.light.exchange
    arriving = exchange.direct @ shares
    b = solve(exchange, table[patch_material], arriving)
    # radiance-like irradiance E / pi; an emitted quantum of wavelength l carries h c / l of energy
    quanta = (1 - table[own]) * lamp * wavelength * trapezoidal_weights(wavelength)
    arriving_patch = (arriving + exchange.form_factors @ b.astype(np.float32)) @ quanta
    arriving_fragment = (transport.direct @ shares + transport.gather @ b.astype(np.float32)) @ quanta
    bell = np.exp(-0.5 * ((light.grid_nm - peak_nm) / _BELL_SIGMA_NM) ** 2) / (_BELL_SIGMA_NM * np.sqrt(2 * np.pi))
    emitted = values["yield"] * light.over_lamp(bell / light.grid_nm)
    return light.change(
        patch_emission=light.patch_emission + np.outer(np.where(patch_material == own, arriving_patch, 0), emitted),
        fragment_emission=light.fragment_emission
        + np.outer(np.where(transport.material == own, arriving_fragment, 0), emitted),
    )


EFFECT = Effect(
    id="fluorescence",
    stage="transport",
    title="a paint turns short wavelengths into longer ones",
    summary="Quanta that the paint absorbs below about 455 nm come back with the stated yield, diffusely, in a "
    "bell about peak_nm (standard deviation about 24 nm); the table's reflectance is kept.",
    parameters=(
        Parameter("material", choices=("white", "red", "green"), kind="material"),
        Parameter("yield", "1", null=0.0, low=0.0, high=1.0, step=0.02),
        Parameter("peak_nm", "nm", low=430.0, high=680.0, step=5.0, default=520.0, starts=_PEAKS_NM),
    ),
    apply=_apply,
    confirm="Light the paint through the 400 nm filter alone and photograph it through the longer ones: signal "
    "there is fluorescence.",
    spectral_step_nm=5,
    sources=("one-step bispectral model: Glassner, 'A model for fluorescence and phosphorescence', 1995",),
)
