"""Sensitivities of a colour sensor from a chart in its picture.

The stimuli are the lamp's spectrum times the filter and the tabulated reflectance of each patch; uneven light is taken
off by ``shading``. Light that reaches the chart by way of coloured walls counts as of the lamp's colour. The level of
the light at the chart is not known, so the sensitivities are relative, with one factor for all channels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WavelengthGrid
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from ..capture import BandTable, Capture, split_channel
from ..correction import CorrectedBands, NoiseModel
from ..instrument import quanta_per_joule
from ..radiometry import NarrowBandReadings, smooth_wiener
from .chart import find_chart
from .patches import patch_levels, patch_pixels, white_patch
from .shading import fit_shading

__all__ = ["ChartSensitivities", "chart_sensitivities"]

#: Wavelengths of the estimate, nm.
_GRID = WavelengthGrid(400.0, 5.0, 61)
#: Fewest patches of known reflectance.
_FEWEST_PATCHES = 12
#: Parts of the patches that are held out in turn.
_FOLDS = 4
#: Error of held-out patches from which the estimate is not used: a chart seen in good light misses by 1 %.
_LARGEST_ERROR = 0.1


@dataclass(frozen=True, eq=False)
class ChartSensitivities(FrozenMappings):
    """Relative sensitivities by channel."""

    #: By letter of the mosaic, quantum efficiency over the largest of all channels.
    curves: Mapping[str, Spectrum]
    #: By letter, relative error of the responses to patches held out of the fit, root mean square.
    held_out: Mapping[str, float]
    #: Number of patches.
    patches: int

    @property
    def note(self) -> str:
        """One sentence on their origin and error."""
        errors = ", ".join(f"{letter} {100 * error:.2g} %" for letter, error in self.held_out.items())
        return (
            f"no quantum_efficiency is stated: relative sensitivities were estimated from {self.patches} patches of "
            f"the chart under the lamp's spectrum; held-out patches are missed by {errors} rms"
        )


def chart_sensitivities(capture: Capture, bands: CorrectedBands, noise: NoiseModel) -> ChartSensitivities | str | None:
    """Estimate the sensitivities of the channels of a mosaic from a chart.

    Parameters
    ----------
    capture
        The capture.
    bands
        The capture's corrected bands.
    noise
        The capture's noise model.

    Returns
    -------
    ChartSensitivities | str | None
        None where sensitivities are stated, and without mosaic, lamp or chart. A sentence where they cannot be
        estimated.

    Raises
    ------
    InputError
        For faulty files, and if [labels] states no image and no chart is found.
    """
    manifest = capture.manifest
    if manifest.camera.quantum_efficiency is not None or manifest.mosaic is None:
        return None
    if manifest.lamp is None or manifest.labels is None:
        return None
    labels = capture.label_names()
    white, reflectances = white_patch(capture, labels), capture.label_reflectances()
    tabulated = [k for k, label in enumerate(labels) if label.column in reflectances]
    if white is None or len(tabulated) < _FEWEST_PATCHES:
        return (
            f"sensitivities cannot be estimated from the chart: {len(tabulated)} patches of known reflectance, "
            f"{_FEWEST_PATCHES} with a white one are needed"
        )
    paints = np.stack([reflectances[str(labels[k].column)].at(_GRID.nm) for k in tabulated])
    lamp = capture.light(manifest.lamp.radiance).at(_GRID.nm)
    image = capture.labels() if manifest.labels.image is not None else find_chart(capture, bands)
    readings: dict[str, list[tuple[NDArray, NDArray, NDArray]]] = {}
    for index, band in enumerate(manifest.band):
        patches = patch_pixels(capture, bands, noise, index, 0.0, labels, image)
        shading = fit_shading([patch for patch in patches if patch is not None])
        level, sigma = (each[tabulated] for each in patch_levels(patches, shading, labels.index(white)))
        clear = np.ones(_GRID.nm.size) if band.transmittance is None else capture.light(band.transmittance).at(_GRID.nm)
        usable = np.isfinite(level)
        letter, _ = split_channel(str(bands.images["channel"].values[index]))
        readings.setdefault(letter, []).append(
            (np.where(usable[:, None], _optics(capture, band) * lamp * clear * paints, 0.0), level, sigma)
        )
    curves, held_out = {}, {}
    for letter, of_bands in readings.items():
        estimate = _estimate(of_bands)
        if estimate is None:
            return f"sensitivities cannot be estimated from the chart: channel {letter} sees too few of its patches"
        curve, held_out[letter] = estimate
        lens = 1.0 if manifest.lens.transmittance is None else capture.light(manifest.lens.transmittance).at(_GRID.nm)
        curves[letter] = curve / (quanta_per_joule(_GRID.nm) * np.maximum(lens, np.finfo(float).tiny))
    worst = max(held_out, key=lambda letter: held_out[letter])
    if held_out[worst] > _LARGEST_ERROR:
        return (
            f"sensitivities cannot be estimated from the chart: held-out patches miss by {100 * held_out[worst]:.2g} % "
            f"in channel {worst} (another lamp, another table, or light of coloured walls)"
        )
    largest = max(float(curve.max()) for curve in curves.values())
    spectra = {letter: Spectrum(_GRID.nm, curve / largest, "zero") for letter, curve in curves.items()}
    return ChartSensitivities(spectra, held_out, len(tabulated))


def _optics(capture: Capture, band: BandTable) -> float:
    """Factor t / (N d)^2 of a band's frames; what is not stated is 1."""
    return band.exposure_s / ((capture.f_number(band) or 1.0) * (capture.image_distance_mm(band) or 1.0)) ** 2


def _estimate(of_bands: Sequence[tuple[NDArray, NDArray, NDArray]]) -> tuple[NDArray[np.float64], float] | None:
    """(n,) sensitivity and held-out relative error of one channel.

    None without enough readings. of_bands : (patch, n) stimuli, (patch,) responses and standard deviations, by band.
    """
    stimuli, response, sigma = (np.concatenate(parts) for parts in zip(*of_bands, strict=True))
    patch = np.concatenate([np.arange(len(part[1])) for part in of_bands])
    good = np.isfinite(response) & (stimuli.sum(axis=1) > 0)
    if np.unique(patch[good]).size < _FEWEST_PATCHES:
        return None

    def fitted(rows: NDArray[np.bool_]) -> NDArray[np.float64]:
        return smooth_wiener(NarrowBandReadings(_GRID.nm, stimuli[rows], response[rows], sigma[rows]))

    missed, weight = 0.0, 0.0
    for fold in range(_FOLDS):
        left_out = good & (patch % _FOLDS == fold)
        predicted = NarrowBandReadings(_GRID.nm, stimuli[left_out], response[left_out], sigma[left_out]).predicted(
            fitted(good & ~left_out)
        )
        # relative to the response, and the darkest patches to what they are of the white one
        missed += float(np.sum((predicted - response[left_out]) ** 2))
        weight += float(np.sum(response[left_out] ** 2))
    return fitted(good), float(np.sqrt(missed / weight))
