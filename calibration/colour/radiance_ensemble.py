"""Plausible radiances, to train and to evaluate filter weights.

The radiance of a surface in a room is the lamp's spectrum times the reflectance of the surface; part of the light
reaches the surface after reflection by others:

     L(l) = L_lamp(l) rho_a(l) (d + (1 - d) rho_b(l) / (1 - q rho_c(l)))

with d the share of direct light, rho_b the reflectance of the surface that reflected the rest, and q, rho_c describing
further reflections in an enclosure (a geometric series). Training uses the 99 object samples of CIE 224:2017 and the
scene's materials if they are known. Evaluation uses the 24 patches of a ColorChecker and the materials of the published
box.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes import cornell_box
from cboxlab.scenes.spectra import planck
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from numpy.typing import NDArray

__all__ = ["Radiances", "evaluation_radiances", "general_lamps", "training_radiances", "training_whites"]

#: Reflectances are raised to a power in this range, which models pigment layers of different thickness.
_POWERS = (0.6, 1.6)
#: Relative standard deviation of the lamp's spectral shape, as between spectroradiometers.
_LAMP_SHAPE = 0.01
#: Correlation length of that shape, nm.
_LAMP_LENGTH_NM = 50.0
#: Every n-th radiance is that of a white surface in direct light.
_WHITES = 20
#: Share of the surfaces with a reflectance of the scene's materials, if these are known.
_SCENE_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class Radiances:
    """Spectral radiances with their whites."""

    #: n labels.
    names: tuple[str, ...]
    #: (n, wavelength) radiances on WAVELENGTH_NM, in the same relative units as `white`.
    values: NDArray[np.float64]
    #: (n, wavelength) radiance of a perfect diffuser in the same direct light.
    white: NDArray[np.float64]


def _smooth_noise(count: int, length_nm: float, generator: np.random.Generator) -> NDArray[np.float64]:
    """(count, wavelength) Gaussian processes, unit variance, squared-exponential covariance."""
    distance = np.subtract.outer(WAVELENGTH_NM, WAVELENGTH_NM) / length_nm
    values, vectors = np.linalg.eigh(np.exp(-(distance**2) / 2))
    main = values > 1e-9 * values[-1]
    return generator.standard_normal((count, int(main.sum()))) @ (vectors[:, main] * np.sqrt(values[main])).T


def general_lamps() -> dict[str, NDArray[np.float64]]:
    """Spectra of common lamps: incandescent, daylight, phosphor LED, fluorescent.

    Returns
    -------
    dict[str, NDArray]
        By name, (wavelength,) spectrum of mean 1 on WAVELENGTH_NM.
    """
    from colour import SDS_ILLUMINANTS  # slow to import, and only needed here

    lamps = {f"{kelvin} K": planck(WAVELENGTH_NM, kelvin) for kelvin in (2856.0, 3200.0, 4500.0)}
    for name in ("D50", "D65", "FL8", "LED-B1", "LED-B3", "LED-B5"):
        table = SDS_ILLUMINANTS[name]
        lamps[name] = np.interp(WAVELENGTH_NM, table.wavelengths, table.values)
    return {name: values / values.mean() for name, values in lamps.items()}


def object_reflectances() -> NDArray[np.float64]:
    """Colour evaluation samples of CIE 224:2017: plants, skin, textiles, paints, plastics.

    Returns
    -------
    NDArray
        (99, wavelength) reflectances on WAVELENGTH_NM.
    """
    from colour import SpectralShape  # slow to import, and only needed here
    from colour.quality.cfi2017 import load_TCS_CIE2017

    samples = load_TCS_CIE2017(SpectralShape(380, 780, 5))
    return np.stack([np.interp(WAVELENGTH_NM, samples.wavelengths, column) for column in samples.values.T])


def training_radiances(
    lamps: Mapping[str, NDArray[np.float64]],
    scene_reflectances: NDArray[np.float64] | None = None,
    count: int = 4000,
    seed: int = 1997,
) -> NDArray[np.float64]:
    """Random radiances under each lamp in turn, by the formula of this module.

    Parameters
    ----------
    lamps
        Spectra on WAVELENGTH_NM, by name.
    scene_reflectances
        (n, wavelength) of the scene's materials; None if they are not known.
    count
        Number of radiances.
    seed
        Seed of the random numbers.

    Returns
    -------
    NDArray
        (count, wavelength) radiances, relative.
    """
    generator = np.random.default_rng(seed)
    objects = object_reflectances()

    def reflectances() -> NDArray[np.float64]:
        sample = objects[generator.integers(0, len(objects), count)]
        if scene_reflectances is not None:
            scene = generator.random(count) < _SCENE_SHARE
            sample[scene] = scene_reflectances[generator.integers(0, len(scene_reflectances), int(scene.sum()))]
        return np.asarray(sample ** generator.uniform(*_POWERS, (count, 1)), np.float64)

    light = training_whites(lamps, count)
    shape = 1 + _LAMP_SHAPE * _smooth_noise(count, _LAMP_LENGTH_NM, generator)
    surface, through, others = (reflectances() for _ in range(3))
    direct = generator.uniform(0, 1, (count, 1))
    enclosure = generator.uniform(0, 0.9, (count, 1))
    surface[::_WHITES], direct[::_WHITES] = 1.0, 1.0
    return light * shape * surface * (direct + (1 - direct) * through / (1 - enclosure * others))


def training_whites(lamps: Mapping[str, NDArray[np.float64]], count: int = 4000) -> NDArray[np.float64]:
    """White of each training radiance: a perfect diffuser in direct light.

    Parameters
    ----------
    lamps
        Spectra on WAVELENGTH_NM, by name.
    count
        Number of radiances.

    Returns
    -------
    NDArray
        (count, wavelength) the lamps in turn, each of mean 1.
    """
    spectra = np.stack([lamp / lamp.mean() for lamp in lamps.values()])
    return np.asarray(spectra[np.arange(count) % len(spectra)], np.float64)


def measured_reflectances() -> dict[str, NDArray[np.float64]]:
    """The 24 patches of a ColorChecker (measured by N. Ohta, 1997) and the materials of the box.

    Returns
    -------
    dict[str, NDArray]
        By name, (wavelength,) reflectance on WAVELENGTH_NM.
    """
    from colour import SDS_COLOURCHECKERS  # slow to import, and only needed here

    patches = {
        name: np.interp(WAVELENGTH_NM, table.wavelengths, table.values)
        for name, table in SDS_COLOURCHECKERS["ColorChecker N Ohta"].items()
    }
    materials = cornell_box().materials.items()
    return patches | {f"box {name}": material.reflectance.at(WAVELENGTH_NM) for name, material in materials}


def evaluation_radiances(lamps: Mapping[str, NDArray[np.float64]]) -> Radiances:
    """Measured reflectances under each lamp, in direct light and in light of each material.

    The reflected light is rho_b / (1 - rho_b / 2) times the lamp: one or more reflections in a half-open enclosure.

    Parameters
    ----------
    lamps
        Spectra on WAVELENGTH_NM, by name.

    Returns
    -------
    Radiances
        Radiances of every lamp, reflectance and path of the light.
    """
    reflectances = measured_reflectances()
    materials = {name: values for name, values in reflectances.items() if name.startswith("box ")}
    names, values, whites = [], [], []
    for lamp, spectrum in lamps.items():
        unit = spectrum / spectrum.mean()
        for name, reflectance in reflectances.items():
            for via, material in {"": None, **materials}.items():
                indirect = 1.0 if material is None else material / (1 - material / 2)
                names.append(f"{lamp}, {name}" + (f" via {via}" if via else ""))
                values.append(unit * reflectance * indirect)
                whites.append(unit)
    return Radiances(tuple(names), np.stack(values), np.stack(whites))
