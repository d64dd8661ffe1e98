"""Plausible radiances: lamp times reflectances times interreflection, to train and to judge filter weights.

What a camera sees in a room is a lamp's spectrum times the reflectance of the surface seen, and part of the
light reached that surface by way of others:

    L(l) = L_lamp(l) rho_a(l) (d + (1 - d) rho_b(l) / (1 - q rho_c(l)))

with d the share of direct light, rho_b the surface that coloured the rest, and q, rho_c the further
reflections in an enclosure, a geometric series. Training takes the 99 samples of real objects of CIE 224:2017
and the scene's own paints where they are known; judging takes the 24 patches of a ColorChecker and the
published box's paints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes import cornell_box
from cboxlab.scenes.spectra import planck
from numpy.typing import NDArray

from .sensor_equation import WAVELENGTH_NM

__all__ = ["Radiances", "general_lamps", "judging_radiances", "training_radiances"]

# Reflectances are raised to a power between these: the same pigment, thinner and thicker.
_POWERS = (0.6, 1.6)
# Relative standard deviation of the lamp's shape over the given length: spectroradiometers agree no better.
_LAMP_SHAPE, _LAMP_LENGTH_NM = 0.01, 50.0
# One in so many radiances is the lamp itself or a white surface that it lights.
_WHITES = 20
# Share of the surfaces that have one of the scene's own paints, where these are known.
_OWN_PAINTS = 0.5


@dataclass(frozen=True, eq=False)
class Radiances:
    """names : n labels. values : (n, wavelength) on WAVELENGTH_NM, each relative to its lamp's ``white``.

    white : (n, wavelength) radiance of a perfect diffuser in the same direct light.
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    white: NDArray[np.float64]


def _smooth_noise(count: int, length_nm: float, generator: np.random.Generator) -> NDArray[np.float64]:
    """(count, wavelength) Gaussian processes of unit variance and squared-exponential covariance."""
    distance = np.subtract.outer(WAVELENGTH_NM, WAVELENGTH_NM) / length_nm
    values, vectors = np.linalg.eigh(np.exp(-(distance**2) / 2))
    kept = values > 1e-9 * values[-1]
    return generator.standard_normal((count, int(kept.sum()))) @ (vectors[:, kept] * np.sqrt(values[kept])).T


def general_lamps() -> dict[str, NDArray[np.float64]]:
    """Lamps for a capture that states none: incandescent, daylight, phosphor LEDs, broadband fluorescent."""
    from colour import SDS_ILLUMINANTS  # slow to import, and only needed here

    lamps = {f"{kelvin} K": planck(WAVELENGTH_NM, kelvin) for kelvin in (2856.0, 3200.0, 4500.0)}
    for name in ("D50", "D65", "FL8", "LED-B1", "LED-B3", "LED-B5"):
        table = SDS_ILLUMINANTS[name]
        lamps[name] = np.interp(WAVELENGTH_NM, table.wavelengths, table.values)
    return {name: values / values.mean() for name, values in lamps.items()}


def object_reflectances() -> NDArray[np.float64]:
    """(99, wavelength) the colour evaluation samples of CIE 224:2017: plants, skin, textiles, paints, plastics."""
    from colour import SpectralShape  # slow to import, and only needed here
    from colour.quality.cfi2017 import load_TCS_CIE2017

    samples = load_TCS_CIE2017(SpectralShape(380, 780, 5))
    return np.stack([np.interp(WAVELENGTH_NM, samples.wavelengths, column) for column in samples.values.T])


def training_radiances(
    lamps: Mapping[str, NDArray[np.float64]],
    paints: NDArray[np.float64] | None = None,
    count: int = 4000,
    seed: int = 1997,
) -> NDArray[np.float64]:
    """(count, wavelength) random radiances under the lamps in turn, see the module's formula.

    lamps : spectra on WAVELENGTH_NM. paints : (n, wavelength) reflectances that the scene is known to have.
    """
    generator = np.random.default_rng(seed)
    objects = object_reflectances()

    def reflectances() -> NDArray[np.float64]:
        drawn = objects[generator.integers(0, len(objects), count)]
        if paints is not None:
            own = generator.random(count) < _OWN_PAINTS
            drawn[own] = paints[generator.integers(0, len(paints), int(own.sum()))]
        return np.asarray(drawn ** generator.uniform(*_POWERS, (count, 1)), np.float64)

    spectra = np.stack([lamp / lamp.mean() for lamp in lamps.values()])
    light = spectra[np.arange(count) % len(spectra)]
    shape = 1 + _LAMP_SHAPE * _smooth_noise(count, _LAMP_LENGTH_NM, generator)
    surface, through, others = (reflectances() for _ in range(3))
    direct = generator.uniform(0, 1, (count, 1))
    enclosure = generator.uniform(0, 0.9, (count, 1))
    surface[::_WHITES], direct[::_WHITES] = 1.0, 1.0
    return light * shape * surface * (direct + (1 - direct) * through / (1 - enclosure * others))


def measured_reflectances() -> dict[str, NDArray[np.float64]]:
    """The 24 patches of a ColorChecker (measured by N. Ohta, 1997) and the published box's paints."""
    from colour import SDS_COLOURCHECKERS  # slow to import, and only needed here

    found = {
        name: np.interp(WAVELENGTH_NM, table.wavelengths, table.values)
        for name, table in SDS_COLOURCHECKERS["ColorChecker N Ohta"].items()
    }
    paints = cornell_box().materials.items()
    return found | {f"box {name}": paint.reflectance.at(WAVELENGTH_NM) for name, paint in paints}


def judging_radiances(lamps: Mapping[str, NDArray[np.float64]]) -> Radiances:
    """Measured reflectances under each lamp: directly, and by light from each of the box's paints.

    The indirect light is rho_b / (1 - rho_b / 2): reflected once or more by an enclosure that is half open.
    """
    reflectances = measured_reflectances()
    paints = {name: values for name, values in reflectances.items() if name.startswith("box ")}
    names, values, whites = [], [], []
    for lamp, spectrum in lamps.items():
        unit = spectrum / spectrum.mean()
        for name, reflectance in reflectances.items():
            for via, paint in {"": None, **paints}.items():
                indirect = 1.0 if paint is None else paint / (1 - paint / 2)
                names.append(f"{lamp}, {name}" + (f" by way of {via}" if via else ""))
                values.append(unit * reflectance * indirect)
                whites.append(unit)
    return Radiances(tuple(names), np.stack(values), np.stack(whites))
