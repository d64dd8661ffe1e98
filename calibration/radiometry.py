"""Absolute radiometry: the constant C of the sensor equation from frames of a source of known radiance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
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

__all__ = ["BandConstant", "Radiometry", "band_scatter", "join_constants", "measure_constant"]

# Normal noise reaches this many standard deviations once in 2.6e7 pixels.
_OUTLIER_SIGMAS = 5.5
# Chi-square per pixel above which a reference is called uneven: noise gives 1.00 +- 0.02 for 5000.
_NOT_UNIFORM = 1.1
_IMPROBABLE = 1e-3


@dataclass(frozen=True)
class BandConstant:
    """C by the reference tables of a band: its value, one standard deviation by noise, the pixels used."""

    band: str
    constant: float
    sigma: float
    pixels: int


@dataclass(frozen=True)
class Radiometry:
    """C in mm^2 m^2 / (e-/DN), one for all bands.

    constant, sigma : the weighted mean of ``by_band``; without references the nominal value and None. weights :
        (len(by_band),) of the bands in it, of unit sum.
    scatter : relative standard deviation between bands beyond noise. degrees : of freedom of sigma, for Student's
        t: infinite where noise is all there is, one less than the bands where it is their scatter.
    nominal : from focal length, pixel area and stated gain; None where one of them is not stated.
    chi2, chi2_degrees : of the bands' scatter about the mean; probability : of at least that much by noise.
    """

    constant: float | None
    sigma: float | None
    nominal: float | None
    by_band: tuple[BandConstant, ...]
    weights: NDArray[np.float64]
    scatter: float
    degrees: float
    chi2: float
    chi2_degrees: int
    notes: tuple[str, ...]

    @property
    def probability(self) -> float:
        """Chance of a chi2 at least this large if one C held for all bands; 1 for a single band."""
        return float(chi2.sf(self.chi2, self.chi2_degrees)) if self.chi2_degrees else 1.0


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

    One constant is fitted to all bands, see ``join_constants``; where they scatter beyond noise (less than one
    chance in a thousand) a note names the worst band. The uncertainty of the reference's own spectrum is not part
    of the format and not part of sigma.

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
        return Radiometry(nominal, None, nominal, (), np.zeros(0), 0.0, np.inf, 0.0, 0, tuple(notes))
    return join_constants(constants, nominal, notes)


def band_scatter(constants: Sequence[BandConstant]) -> float:
    """Relative standard deviation between the bands' constants C beyond their own noise.

    That is what flats, filter curves, lamp and shutter do to a band: C itself is one for all. By the moment
    estimator of DerSimonian and Laird (1986); 0 where noise explains the scatter or for a single band.
    """
    if len(constants) < 2:
        return 0.0
    value = np.array([c.constant for c in constants])
    weight = 1 / np.array([c.sigma for c in constants]) ** 2
    mean = np.average(value, weights=weight)
    excess = np.sum(weight * (value - mean) ** 2) - (value.size - 1)
    spread = excess / (weight.sum() - np.sum(weight**2) / weight.sum())
    return float(np.sqrt(max(spread, 0.0)) / mean)


def _one_per_band(constants: Sequence[BandConstant]) -> tuple[BandConstant, ...]:
    """A band photographed against several references has one filter: its tables are no independent bands."""
    joined = []
    for band in dict.fromkeys(c.band for c in constants):
        own = [c for c in constants if c.band == band]
        weight = np.array([c.sigma for c in own]) ** -2.0
        value = float(np.average([c.constant for c in own], weights=weight))
        joined.append(BandConstant(band, value, float(weight.sum() ** -0.5), sum(c.pixels for c in own)))
    return tuple(joined)


def join_constants(
    constants: Sequence[BandConstant], nominal: float | None, notes: Sequence[str] = ()
) -> Radiometry:
    """One C from those of at least one reference table.

    Bands are weighted by 1 / (noise^2 + scatter^2) with ``band_scatter``.
    """
    by_band, notes = _one_per_band(constants), list(notes)
    values, noise = (np.array([getattr(c, name) for c in by_band]) for name in ("constant", "sigma"))
    weights = 1 / noise**2
    mean = float(np.average(values, weights=weights))
    misfit, degrees = float(np.sum(weights * (values - mean) ** 2)), values.size - 1
    if degrees and chi2.sf(misfit, degrees) < _IMPROBABLE:
        worst = by_band[int(np.argmax(weights * (values - mean) ** 2))]
        notes.append(
            f"C differs between bands beyond noise (chi2 {misfit:.1f} for {degrees}), most in {worst.band}: "
            f"{worst.constant / mean - 1:+.2%}"
        )
    scatter = band_scatter(by_band)
    shares = 1 / (noise**2 + (scatter * mean) ** 2)
    shares /= shares.sum()
    mean = float(np.sum(shares * values))
    variance = float(np.sum(shares**2 * (noise**2 + (scatter * mean) ** 2)))
    freedom = degrees if scatter else np.inf
    return Radiometry(
        mean,
        float(np.sqrt(variance)),
        nominal,
        by_band,
        shares,
        scatter,
        freedom,
        misfit,
        degrees,
        tuple(notes),
    )
