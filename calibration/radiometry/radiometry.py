"""The constant C of the sensor equation, from a source of known radiance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.distributions import chi2_tail
from numpy.typing import NDArray

from ..capture import Capture, ReferenceTable, channel_mask
from ..correction import (
    CorrectedBands,
    DarkLibrary,
    NoiseModel,
    correct,
    dark_level_sigmas,
    evaluate_variance,
    uniform_flat,
)
from ..instrument import Mask
from .sensor_equation import assumed_keys, counts_over_constant, nominal_constant

__all__ = ["BandConstant", "Radiometry", "band_scatter", "join_constants", "measure_constant"]

#: Normal noise exceeds this many standard deviations once in 2.6e7 pixels.
_OUTLIER_SIGMAS = 5.5
#: Chi-square per pixel above which a reference is reported as not uniform; noise gives 1.00 +- 0.02 for 5000 pixels.
_NOT_UNIFORM = 1.1
#: Probability of the chi-square between bands below which a note names the worst band.
_IMPROBABLE = 1e-3
#: C of a capture with a free scale that states no lens and gain: any number, replaced in the comparison with a model.
_ARBITRARY_CONSTANT = 1.0


@dataclass(frozen=True)
class BandConstant:
    """Constant C from the reference tables of one band."""

    #: Identifier of the band.
    band: str
    #: C, mm^2 m^2 / (e-/DN).
    constant: float
    #: Standard deviation of C by noise, and by the dark level where no darks measured it.
    sigma: float
    #: Number of pixels used.
    pixels: int
    #: The part of the dark level.
    dark_sigma: float = 0.0


@dataclass(frozen=True)
class Radiometry:
    """Constant C of the sensor equation, one for all bands, in mm^2 m^2 / (e-/DN)."""

    #: Weighted mean of `by_band`; without references the nominal value, or None if that is not stated.
    constant: float | None
    #: Standard deviation of `constant`; None without references.
    sigma: float | None
    #: C from focal length, pixel area and stated gain; None if one of them is not stated.
    nominal: float | None
    #: Constant of each band with a usable reference.
    by_band: tuple[BandConstant, ...]
    #: (len(by_band),) weights of the bands in the mean, of unit sum.
    weights: NDArray[np.float64]
    #: Relative standard deviation between bands in excess of noise.
    scatter: float
    #: Degrees of freedom of `sigma`, for Student's t: infinite without excess scatter, else the number of bands minus
    #: one.
    degrees: float
    #: Chi-square of the bands about their mean weighted by noise.
    chi2: float
    #: Degrees of freedom of `chi2`.
    chi2_degrees: int
    #: References not used or not uniform, bands that differ.
    notes: tuple[str, ...]
    #: Whether the scale is free: `constant` is then that of the comparison with a model, or an arbitrary one.
    is_free: bool = False
    #: (band,) factors of the bands on `constant`, in the manifest's order; None where all are 1.
    band_factors: NDArray[np.float64] | None = None
    #: Relative standard deviation of `constant` by a dark level that no darks measured, as if alike in all bands.
    dark_sigma: float = 0.0

    @property
    def band_constants(self) -> float | NDArray[np.float64] | None:
        """C of all bands, or (band,) C of each where each is free; None where it is not known."""
        if self.constant is None or self.band_factors is None:
            return self.constant
        return self.constant * self.band_factors

    @property
    def probability(self) -> float:
        """Probability of a larger chi2 by noise if all bands have one C; 1 for a single band."""
        return float(chi2_tail(self.chi2, self.chi2_degrees)) if self.chi2_degrees else 1.0


def _reference_constant(
    capture: Capture,
    table: ReferenceTable,
    bands: CorrectedBands,
    dark: DarkLibrary,
    noise: NoiseModel,
    channel: str | None,
) -> tuple[BandConstant, float] | None:
    """C from one table and its chi-square per pixel of uniformity; None if undetermined."""
    unit = counts_over_constant(capture, table, table.radiance, channel)
    if unit is None:
        return None
    flat = bands.flats[table.band]
    net = correct(capture, table, uniform_flat(capture.shape, dark), dark, noise)
    unusable = Mask.HOT | Mask.DEAD | Mask.VIGNETTED
    good = ~net.saturated & ~flat.saturated & ((bands.images["mask"].sel(band=table.band).values & unusable) == 0)
    if channel is not None and capture.manifest.mosaic is not None:
        good &= channel_mask(capture.manifest.mosaic.pattern, capture.shape, channel)
    variance = evaluate_variance(net.coefficients, net.signal)
    for _ in range(2):
        if not np.any(good):
            return None
        # A ratio of sums: a mean of ratios would be biased by the noise of the flat in the denominator.
        level = net.signal[good].sum() / flat.response[good].sum()
        residual = (net.signal - level * flat.response) ** 2 / (variance + level**2 * flat.relative_variance)
        spread = float(residual[good].mean())
        good &= residual < _OUTLIER_SIGMAS**2 * max(spread, 1.0)
    # The mean of the flat over the field is 1 by definition, so its noise is not included.
    sum_of_flat = unit * flat.response[good].sum()
    of_noise = float(np.sqrt(variance[good].sum())) / sum_of_flat
    of_dark = float(dark_level_sigmas(capture, [table], noise.shot_dn)[0]) * good.sum() / sum_of_flat
    return BandConstant(table.band, level / unit, np.hypot(of_noise, of_dark), int(good.sum()), of_dark), spread


def measure_constant(
    capture: Capture,
    bands: CorrectedBands,
    dark: DarkLibrary,
    noise: NoiseModel,
    channels: Mapping[str, str] | None = None,
) -> Radiometry:
    """Constant C from all reference tables of a capture.

    C is net counts over flat, divided by t f^-2 d^-2 Int F Q T L dl. One constant is fitted to all bands, see
    ``join_constants``. If the bands differ significantly (probability below 0.001), a note names the worst one. sigma
    does not include the uncertainty of the reference's spectrum, which the capture format does not state.

    Parameters
    ----------
    capture
        Capture, with `[[reference]]` tables or without.
    bands
        The capture's corrected bands, whose flats are used.
    dark
        The capture's darks.
    noise
        The capture's noise model.
    channels
        By band, the channel of a sensor with a mosaic; None without a mosaic.

    Returns
    -------
    Radiometry
        C; the nominal value of the lens (or None) without usable references.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    if not capture.manifest.is_absolute:
        return _free_constant(capture)
    notes, constants = [], []
    for table in capture.manifest.reference:
        if table.band in bands.faint:
            continue
        channel = None if channels is None else channels[table.band]
        reference = _reference_constant(capture, table, bands, dark, noise, channel)
        if reference is None:
            notes.append(f"{table.band}: reference not used: incomplete tables or no usable pixel")
            continue
        constant, spread = reference
        constants.append(constant)
        if spread > _NOT_UNIFORM:
            notes.append(
                f"{table.band}: reference and flat have different shapes: the variance of their ratio is "
                f"{spread:.2f} times that of noise (an uneven reference, or a flat of another aperture or position)"
            )
    nominal = nominal_constant(capture)
    if not constants:
        why = "no reference frames" if not capture.manifest.reference else "no usable reference frame"
        notes.append(f"{why}: C is {'unknown' if nominal is None else 'the nominal value of the lens'}")
        return Radiometry(nominal, None, nominal, (), np.zeros(0), 0.0, np.inf, 0.0, 0, tuple(notes))
    return join_constants(constants, nominal, notes)


def _free_constant(capture: Capture) -> Radiometry:
    """The nominal constant, or an arbitrary one, of a capture that claims no absolute scale."""
    nominal = nominal_constant(capture)
    manifest = capture.manifest
    each = "of each band" if manifest.is_free_by_band else "of all bands"
    why = "" if manifest.scale == "free-by-band" or not manifest.is_free_by_band else ", since the lens's colour is not"
    notes = [f'no absolute scale is claimed (scale = "{manifest.scale}"): one factor {each} is not known{why}']
    if assumed := assumed_keys(capture):
        notes.append(f"{', '.join(assumed)} not stated: taken as 1, in transmittances at all wavelengths")
    if capture.manifest.reference:
        notes.append("the [[reference]] frames are not used for the scale, which is free")
    constant = _ARBITRARY_CONSTANT if nominal is None else nominal
    return Radiometry(constant, None, nominal, (), np.zeros(0), 0.0, np.inf, 0.0, 0, tuple(notes), True)


def band_scatter(constants: Sequence[BandConstant]) -> float:
    """Relative standard deviation between the bands' constants C in excess of noise.

    C is the same for all bands; errors of flats, filter curves, lamp and shutter cause the excess. Moment estimator of
    DerSimonian and Laird (1986).

    Parameters
    ----------
    constants
        One constant per band.

    Returns
    -------
    float
        Relative standard deviation; 0 if noise explains the scatter and for a single band.
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
    """Weighted mean of each band's constants.

    Several references of one band are not independent bands.
    """
    joined = []
    for band in dict.fromkeys(c.band for c in constants):
        of_band = [c for c in constants if c.band == band]
        weight = np.array([c.sigma for c in of_band]) ** -2.0
        value = float(np.average([c.constant for c in of_band], weights=weight))
        dark = float(np.average([c.dark_sigma for c in of_band], weights=weight))
        joined.append(BandConstant(band, value, float(weight.sum() ** -0.5), sum(c.pixels for c in of_band), dark))
    return tuple(joined)


def join_constants(constants: Sequence[BandConstant], nominal: float | None, notes: Sequence[str] = ()) -> Radiometry:
    """One constant C from those of the reference tables.

    Bands are weighted by 1 / (noise^2 + scatter^2), see ``band_scatter``.

    Parameters
    ----------
    constants
        Constants of at least one reference table.
    nominal
        C of the nominal lens; None where it is not stated.
    notes
        Notes to which one on differing bands is added.

    Returns
    -------
    Radiometry
        The constant with its standard deviation, and the bands' weights.
    """
    by_band, notes = _one_per_band(constants), list(notes)
    values, noise = (np.array([getattr(c, name) for c in by_band]) for name in ("constant", "sigma"))
    weights = 1 / noise**2
    mean = float(np.average(values, weights=weights))
    misfit, degrees = float(np.sum(weights * (values - mean) ** 2)), values.size - 1
    if degrees and chi2_tail(misfit, degrees) < _IMPROBABLE:
        # from the median: one that is far off takes the mean with it
        middle = float(np.median(values))
        worst = by_band[int(np.argmax(weights * (values - middle) ** 2))]
        notes.append(
            f"C differs between bands by more than noise (chi2 {misfit:.1f}, {degrees} degrees of freedom), most in "
            f"{worst.band}: {worst.constant / middle - 1:+.2%}"
        )
    scatter = band_scatter(by_band)
    shares = 1 / (noise**2 + (scatter * mean) ** 2)
    shares /= shares.sum()
    mean = float(np.sum(shares * values))
    of_dark = shares * [c.dark_sigma for c in by_band]
    dark = float(of_dark.sum())
    variance = float(np.sum(shares**2 * (noise**2 + (scatter * mean) ** 2))) + dark**2 - float(of_dark @ of_dark)
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
        dark_sigma=dark / mean,
    )
