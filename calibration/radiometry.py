"""Absolute radiometry: the constant C of the sensor equation from frames of a source of known radiance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from .band_images import Mask
from .capture import Capture
from .corrected_bands import CorrectedBands
from .correction import correct, evaluate_variance, uniform_flat
from .dark import DarkLibrary
from .manifest import ReferenceTable
from .mosaic import channel_mask
from .noise import NoiseModel
from .sensor_equation import (
    WAVELENGTH_NM,
    nominal_constant,
    optical_factor,
    response_curve,
    trapezoidal_weights,
)

__all__ = ["BandConstant", "Radiometry", "measure_constant"]

# Normal noise reaches this many standard deviations once in 2.6e7 pixels.
_OUTLIER_SIGMAS = 5.5
# Chi-square per pixel above which a reference is called uneven: noise gives 1.00 +- 0.02 for 5000.
_NOT_UNIFORM = 1.1
_IMPROBABLE = 1e-3


@dataclass(frozen=True)
class BandConstant:
    """C by one reference table: its value, one standard deviation by noise, the pixels used."""

    band: str
    constant: float
    sigma: float
    pixels: int


@dataclass(frozen=True)
class Radiometry:
    """C in mm^2 m^2 / (e-/DN), one for all bands.

    constant, sigma : the weighted mean of ``by_band``; without references the nominal value and None.
    nominal : from focal length, pixel area and stated gain; None where one of them is not stated.
    chi2, degrees : of the bands' scatter about the mean; probability : of at least that much by noise.
    """

    constant: float | None
    sigma: float | None
    nominal: float | None
    by_band: tuple[BandConstant, ...]
    chi2: float
    degrees: int
    notes: tuple[str, ...]

    @property
    def probability(self) -> float:
        """Chance of a chi2 at least this large if one C held for all bands; 1 for a single band."""
        return float(chi2.sf(self.chi2, self.degrees)) if self.degrees else 1.0


def _reference_constant(
    capture: Capture,
    table: ReferenceTable,
    bands: CorrectedBands,
    dark: DarkLibrary,
    noise: NoiseModel,
    channel: str | None,
) -> tuple[BandConstant, float] | None:
    """C by one table and the chi-square per pixel of its uniformity; None where it cannot be had."""
    band = capture.band(table.band)
    curve, factor = response_curve(capture, band, channel), optical_factor(capture, table)
    if curve is None or factor is None:
        return None
    flat = bands.flats[band.id]
    net = correct(capture, table, uniform_flat(capture.shape, dark), dark, noise)
    unusable = Mask.HOT | Mask.DEAD | Mask.VIGNETTED
    good = (
        ~net.saturated & ~flat.saturated & ((bands.images["mask"].sel(band=band.id).values & unusable) == 0)
    )
    if channel is not None and capture.manifest.mosaic is not None:
        good &= channel_mask(capture.manifest.mosaic.pattern, capture.shape, channel)
    radiance = capture.light(table.radiance).at(WAVELENGTH_NM)
    unit = factor * float(np.sum(trapezoidal_weights(WAVELENGTH_NM) * curve * radiance))
    variance = evaluate_variance(net.coefficients, net.signal)
    for _ in range(2):
        if not np.any(good):
            return None
        # A ratio of sums: the mean of ratios would be biased by the noise of the flat in the denominator.
        level = net.signal[good].sum() / flat.response[good].sum()
        residual = (net.signal - level * flat.response) ** 2 / (variance + level**2 * flat.relative_variance)
        spread = float(residual[good].mean())
        good &= residual < _OUTLIER_SIGMAS**2 * max(spread, 1.0)
    # The mean of the flat is 1 by definition, so its noise cancels in the sum over the field.
    sigma = float(np.sqrt(variance[good].sum())) / flat.response[good].sum()
    return BandConstant(band.id, level / unit, sigma / unit, int(good.sum())), spread


def measure_constant(
    capture: Capture,
    bands: CorrectedBands,
    dark: DarkLibrary,
    noise: NoiseModel,
    channels: Mapping[str, str] | None = None,
) -> Radiometry:
    """C from every reference table: net counts over flat, divided by t f^-2 d^-2 Int F Q T L dl.

    One constant is fitted to all bands by the weighted mean; where they scatter beyond noise (less than
    one chance in a thousand) its sigma grows by sqrt(chi2 / degrees) and a note names the worst band. The
    uncertainty of the reference's own spectrum is not part of the format and not part of sigma.

    Raises InputError for a faulty frame.
    """
    notes, constants = [], []
    for table in capture.manifest.reference:
        channel = None if channels is None else channels[table.band]
        found = _reference_constant(capture, table, bands, dark, noise, channel)
        if found is None:
            notes.append(
                f"{table.band}: no constant from its reference: incomplete tables or no usable pixel"
            )
            continue
        constants.append(found[0])
        if found[1] > _NOT_UNIFORM:
            notes.append(
                f"{table.band}: the reference over the flat varies {found[1]:.2f} times as much as noise"
            )
    nominal = nominal_constant(capture)
    if not constants:
        why = "no reference frames" if not capture.manifest.reference else "no usable reference frame"
        notes.append(f"{why}: C is {'unknown' if nominal is None else 'that of the nominal lens'}")
        return Radiometry(nominal, None, nominal, (), 0.0, 0, tuple(notes))
    values = np.array([c.constant for c in constants])
    weights = 1 / np.array([c.sigma for c in constants]) ** 2
    mean, sigma = float(np.average(values, weights=weights)), float(weights.sum() ** -0.5)
    scatter, degrees = float(np.sum(weights * (values - mean) ** 2)), values.size - 1
    if degrees and chi2.sf(scatter, degrees) < _IMPROBABLE:
        worst = constants[int(np.argmax(weights * (values - mean) ** 2))]
        notes.append(
            f"C differs between bands beyond noise (chi2 {scatter:.1f} for {degrees}), most in {worst.band}: "
            f"{worst.constant / mean - 1:+.2%}"
        )
        sigma *= float(np.sqrt(scatter / degrees))
    return Radiometry(mean, sigma, nominal, tuple(constants), scatter, degrees, tuple(notes))
