"""Fluorescence: one material absorbs short wavelengths and emits longer ones.

Quanta that the paint absorbs below 455 nm return diffusely with the quantum yield. Their spectrum is a Gaussian about
peak_nm of standard deviation 24 nm. A quantum has the energy h c / lambda, so the emitted radiance is the absorbed
irradiance over pi times yield lambda_in / lambda_out. The table's reflectance stays as it is. The cause is an optical
brightener or a fluorescent pigment.

Parameters: material, name of the paint; yield, emitted over absorbed quanta, null value 0; peak_nm, nm, no null value.
Source: one-step bispectral model, Glassner, 'A model for fluorescence and phosphorescence', 1995.
"""

from __future__ import annotations

import numpy as np
from cboxlab.scenes.wavelength_grid import trapezoidal_weights

from ..perturbation import PatchLight
from ..radiosity import solve_exchange
from .effect import Effect, Parameter, index_of

__all__ = ["EFFECT"]

#: Longest wavelength that the paint absorbs for emission, nm: blue and violet excite optical brighteners.
_ABSORBED_BELOW_NM = 455.0

#: Step of the absorbed wavelengths, nm: that of the emitted ones, ``spectral_step_nm``.
_STEP_NM = 5.0

#: Standard deviation of the emitted spectrum, nm: a full width at half maximum of 57 nm.
_BELL_SIGMA_NM = 24.0

#: Wavelengths at which a search for the peak starts, nm: one every 40 nm, less than the width of the bell.
_PEAKS_NM = (460.0, 500.0, 540.0, 580.0, 620.0, 660.0)


def _apply(light: PatchLight, material: str, peak_nm: float, **values: float) -> PatchLight:
    transport = light.transport
    scene = light.scene
    index = index_of(material, scene.materials, "fluorescence: material")
    wavelength = np.arange(light.grid_nm[0], _ABSORBED_BELOW_NM + 1e-6, _STEP_NM)
    lamp = np.interp(wavelength, light.grid_nm, light.lamp)
    shares = scene.lamp_shares(wavelength)
    table = scene.reflectances(wavelength)
    patch_material = transport.light.patches.material
    exchange = transport.light.exchange
    arriving = exchange.direct @ shares
    b = solve_exchange(exchange, table[patch_material], arriving)
    # radiance-like irradiance E / pi; an emitted quantum of wavelength l carries h c / l of energy
    quanta = (1 - table[index]) * lamp * wavelength * trapezoidal_weights(wavelength)
    arriving_patch = (arriving + exchange.form_factors @ b.astype(np.float32)) @ quanta
    arriving_fragment = (transport.direct @ shares + transport.gather @ b.astype(np.float32)) @ quanta
    bell = np.exp(-0.5 * ((light.grid_nm - peak_nm) / _BELL_SIGMA_NM) ** 2) / (_BELL_SIGMA_NM * np.sqrt(2 * np.pi))
    emitted = values["yield"] * light.over_lamp(bell / light.grid_nm)
    return light.change(
        patch_emission=light.patch_emission + np.outer(np.where(patch_material == index, arriving_patch, 0), emitted),
        fragment_emission=light.fragment_emission
        + np.outer(np.where(transport.material == index, arriving_fragment, 0), emitted),
    )


EFFECT = Effect(
    id="fluorescence",
    stage="transport",
    title="a paint turns short wavelengths into longer ones",
    summary="Quanta that the paint absorbs below about 455 nm return diffusely with the stated yield. Their spectrum "
    "is a bell about peak_nm (standard deviation about 24 nm). The table's reflectance is kept.",
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
