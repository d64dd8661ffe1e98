"""Checks of the constant C against the nominal lens, and of bands, flats and references."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.median_line import median_line
from numpy.typing import NDArray

from ..capture import BandTable, Capture, FlatTable
from ..correction import CorrectedBands, NoiseModel
from ..geometry import CameraFit
from ..radiometry import Radiometry, counts_over_constant
from .frame_checks import Suspicion

__all__ = [
    "centre_nm",
    "check_constant",
    "check_flats_and_references",
    "check_focal_length",
    "power_law",
]

#: Smallest plausible C over its nominal value: stated apertures, gains and lenses are accurate to about 30 %.
LOWEST_CONSTANT = 1 / 1.45

#: Largest plausible C over its nominal value: light from outside the pass band increases it.
HIGHEST_CONSTANT = 1.7

#: Smallest plausible C of one band over the median of all.
LOWEST_BAND = 1 / 1.4

#: Largest plausible C of one band over the median of all: a leak of its filter increases it.
HIGHEST_BAND = 20.0

#: Largest deviation of the bands' C that counts as agreement, natural log.
AGREEING = 0.015

#: Smallest deviation of a single wrong reference if all others agree, natural log.
ALONE = 0.12

#: Largest deviation of flat over reference between bands if both show the same field, natural log.
SAME_FIELD = 0.03

#: Smallest deviation of flat over reference of a wrong frame, natural log.
OTHER_FRAMES = 0.07

#: Deviations of two exchanged flats must vanish without the exchange to this many rms of the other bands' deviations.
UNDONE_SPREADS = 3.0

#: The same at least, natural log: noise of a flat's mean and its dark level.
SMALLEST_UNDONE = 0.002

#: Smallest deviation of exchanged flats over what may remain without the exchange. Flats of nearly equal level that are
#: exchanged change nothing.
EXCHANGE_OVER_UNDONE = 3.0

#: Smallest share of the bands with the same field. Flats may have another level in each band: by chance a sixth of the
#: bands then agree with the median, and this share of FEWEST_BANDS or more with a chance of 1 %.
SMALLEST_AGREEING_SHARE = 0.7

#: Fewest bands for a comparison of flats and references.
FEWEST_BANDS = 5

#: Largest factor of the focal length or the gain that is not named as a cause of C.
LARGEST_FOCAL_RATIO = 1.2

#: Largest factor of the gain by the noise over the stated one that is not named as a cause of C.
LARGEST_GAIN_RATIO = 1.4

#: Largest factor between C over its nominal value and an error that explains it.
EXPLAINED_RATIO = 1.15

#: Largest number of errors that a suspicion names.
MOST_NAMED = 3

#: Largest distance of a power of the wavelength from 1 or -1.
POWER_TOLERANCE = 0.2

#: Largest deviation from the power law of four fifths of the bands, natural log.
STRAIGHT = 0.04

#: Share of the bands that must follow the power law: robust against one band in five (a leak, a wrong exposure).
STRAIGHT_SHARE = 0.8

#: (C over its nominal value, error that causes this ratio).
NAMED_FACTORS = (
    (1e-3, "exposures in ms, or a reference source stated a thousand times too bright (per um, or mW)"),
    (1e3, "a reference source stated a thousand times too dim (kW, or per nm taken for per um)"),
    (1e-2, "a transmittance or quantum efficiency in per cent, or a length in cm"),
    (1e2, "a transmittance or quantum efficiency a hundred times too small, or a length in cm"),
    (1e-4, "a transmittance and a quantum efficiency in per cent, or a radiance per cm^2"),
    (1e4, "a radiance per m^2 taken for cm^2"),
    (1e-6, "an image distance in m"),
    (1e6, "a focal length in m, or a pixel pitch in mm"),
    (4 * np.pi, "a factor of 4 pi"),
    (1 / (4 * np.pi), "a factor of 4 pi"),
    (np.pi, "a factor of pi: radiance taken for irradiance"),
    (1 / np.pi, "a factor of pi: irradiance taken for radiance"),
    (1 / 683.0, "a reference source in photometric units (683 lm/W)"),
    (2.0, "an aperture one stop off"),
    (0.5, "an aperture one stop off"),
    (4.0, "an aperture two stops off"),
    (0.25, "an aperture two stops off"),
)


def check_constant(
    capture: Capture,
    radiometry: Radiometry,
    noise: NoiseModel,
    fit: CameraFit | None,
    channels: Mapping[str, str] | None,
) -> Iterator[Suspicion]:
    """Check C of the references against the nominal lens, and each band's C against the median.

    Parameters
    ----------
    capture
        A capture.
    radiometry
        C by the references of each band, and nominal.
    noise
        Gain by the frames.
    fit
        Camera fitted to the surveyed points; None without one.
    channels
        Channel of each band of a sensor with a mosaic; None without one.

    Yields
    ------
    Suspicion
        One for quanta taken for energy, or else for the level of C and for each band that deviates.
    """
    constants = [c.constant for c in radiometry.by_band]
    if not constants:
        return
    median = float(np.median(constants))
    centre = np.array([centre_nm(capture, capture.band(c.band)) for c in radiometry.by_band])
    if power_law(centre, np.array(constants)) == -1:
        yield Suspicion(
            "the reference source's radiance is in quanta, or the quantum efficiency is in A/W",
            "reference.radiance, camera.quantum_efficiency",
            "The bands' C falls as one over the wavelength; C is one constant for all.",
        )
        return
    if radiometry.nominal:
        focal_px = None if fit is None else fit.camera.focal_length_px
        factors = _named_factors(capture, noise, focal_px)
        yield from _check_level(median, radiometry.nominal, factors)
    if len(constants) >= 3 and median > 0:
        ratios = {c.band: c.constant / median for c in radiometry.by_band}
        yield from _check_bands(capture, ratios, channels)


def _named_factors(capture: Capture, noise: NoiseModel, focal_px: float | None) -> list[tuple[float, str]]:
    """(C over nominal, error that causes this ratio), those that the capture itself shows first.

    focal_px : focal length fitted to the surveyed points, px.
    """
    manifest = capture.manifest
    camera, focal = manifest.camera, manifest.lens.focal_length_mm
    factors = [*NAMED_FACTORS]
    f_number = manifest.band[0].f_number
    if focal is not None and f_number:
        factors.append((f_number**4 / focal**2, "an aperture's diameter in mm in place of the f-number"))
        factors.append(((focal / f_number**2) ** 2, "an f-number in place of something else"))
        if focal_px is not None and camera.pixel_pitch_um:
            other = focal_px * camera.pixel_pitch_um * 1e-3
            if not 1 / LARGEST_FOCAL_RATIO < other / focal < LARGEST_FOCAL_RATIO:
                factors.insert(0, ((other / focal) ** 2, f"a focal length of {other:.3g} mm, as the points show"))
                factors.insert(0, ((focal / other) ** 2, f"a pixel pitch {focal / other:.3g} times larger"))
    if noise.gain_e_per_dn and noise.gain_sigma is not None and camera.gain_e_per_dn:
        ratio = camera.gain_e_per_dn / noise.gain_e_per_dn
        if not 1 / LARGEST_GAIN_RATIO < ratio < LARGEST_GAIN_RATIO:
            factors.insert(0, (ratio, f"a gain of {noise.gain_e_per_dn:.4g} e-/DN, as the noise shows"))
    return factors


def _check_level(median: float, nominal: float, factors: list[tuple[float, str]]) -> Iterator[Suspicion]:
    """Median C against the nominal one. factors : of ``_named_factors``."""
    ratio = median / nominal
    if ratio > 0 and LOWEST_CONSTANT < ratio < HIGHEST_CONSTANT:
        return
    near = [text for factor, text in factors if ratio > 0 and abs(np.log(ratio / factor)) < np.log(EXPLAINED_RATIO)]
    guess = "; ".join(dict.fromkeys(near[:MOST_NAMED])) or (
        "exposure, aperture, image distance, gain, pixel pitch, a transmittance or the source's radiance"
    )
    yield Suspicion(
        f"a quantity of the sensor equation is in another unit or wrong: {guess}",
        "reference",
        f"The references give C = {median:.3g}, focal length, pixel area and gain {nominal:.3g}: "
        f"{ratio:.3g} times as much.",
    )


def _check_bands(
    capture: Capture, ratios: Mapping[str, float], channels: Mapping[str, str] | None
) -> Iterator[Suspicion]:
    """Bands whose C deviates from the median. ratios : C over the median, by band."""
    exchanged = _exchanged(capture, ratios, channels)
    for band, ratio in ratios.items():
        if band in exchanged or not LOWEST_BAND < ratio < HIGHEST_BAND or _is_alone_below(ratios, band):
            yield Suspicion(
                f"the references of {' and '.join(exchanged)} are exchanged"
                if band in exchanged
                else f"the reference of {band} does not suit its exposure, filter or quantum efficiency (frames or "
                "tables of another band)",
                f"reference ({band})",
                f"Its C is {ratio:.3g} times the median of the bands; C is one constant for all.",
            )


def _exchanged(capture: Capture, ratios: Mapping[str, float], channels: Mapping[str, str] | None) -> tuple[str, ...]:
    """Two bands with exchanged references; empty if there are none.

    Frames may be exchanged with or without their exposures. Their C must deviate as the exchange changes it, and all
    others agree.
    """
    deviation = {band: float(np.log(ratio)) for band, ratio in ratios.items() if ratio > 0}
    apart = [band for band in deviation if abs(deviation[band]) > 2 * AGREEING]
    if len(deviation) < 5 or len(apart) != 2:
        return ()
    tables = [capture.references(band)[0] for band in apart]
    units = np.array(
        [
            counts_over_constant(capture, table, table.radiance, channels[table.band] if channels else None) or np.nan
            for table in tables
        ]
    )
    first, second = (deviation[band] for band in apart)
    for counts in (units, units / [table.exposure_s for table in tables]):
        expected = np.log(counts[1] / counts[0])
        if max(abs(first - expected), abs(second + expected)) < max(AGREEING, 0.1 * abs(expected)):
            return tuple(apart)
    return ()


def _is_alone_below(ratios: Mapping[str, float], band: str) -> bool:
    """Whether one band's C is below those of all others, which agree.

    A leak or a shutter changes several bands, and by degrees.
    """
    others = [abs(np.log(ratio)) for other, ratio in ratios.items() if other != band and ratio > 0]
    agreeing = len(others) >= 4 and max(others) < AGREEING
    return agreeing and ratios[band] > 0 and float(np.log(ratios[band])) < -ALONE


def check_flats_and_references(
    capture: Capture, bands: CorrectedBands, radiometry: Radiometry, channels: Mapping[str, str] | None
) -> Iterator[Suspicion]:
    """Check that the ratio of flat and reference is the same in all bands.

    Nothing is checked if flats and references show different fields.

    Parameters
    ----------
    capture
        A capture.
    bands
        The capture's flats.
    radiometry
        C by the references of each band.
    channels
        Channel of each band of a sensor with a mosaic; None without one.

    Yields
    ------
    Suspicion
        For each band whose ratio deviates, while those of most bands agree.
    """
    by_reference = {c.band: c.constant for c in radiometry.by_band}
    by_flat = {}
    for band in capture.band_ids:
        tables = capture.flats(band)
        channel = None if channels is None else channels[band]
        constant = _flat_constant(capture, tables[0], bands.flats[band].mean_dn, channel) if tables else None
        if constant and constant > 0 and by_reference.get(band, 0) > 0:
            by_flat[band] = constant
    if len(by_flat) < FEWEST_BANDS:
        return
    ratio = np.log([by_flat[band] / by_reference[band] for band in by_flat])
    deviation = ratio - np.median(ratio)
    level = np.log([bands.flats[band].mean_dn for band in by_flat])
    exchanged = _exchanged_flats(ratio, level)
    constants = np.log([[by_flat[band], by_reference[band]] for band in by_flat])
    if exchanged is not None and _flats_deviate(constants, exchanged):
        first, second = (list(by_flat)[index] for index in exchanged)
        yield Suspicion(
            f"the flats of {first} and {second} are exchanged",
            f"flat ({first}), flat ({second})",
            f"Flat over reference is {np.exp(deviation[exchanged[0]]):.3g} and {np.exp(deviation[exchanged[1]]):.3g} "
            "times that of the other bands; with the flats exchanged it is the same in all.",
        )
        return
    if np.mean(np.abs(deviation) < SAME_FIELD) < SMALLEST_AGREEING_SHARE:
        return
    flat_median, reference_median = (
        float(np.median(list(v.values()))) for v in (by_flat, {b: by_reference[b] for b in by_flat})
    )
    for band, difference in zip(by_flat, deviation, strict=True):
        if abs(difference) < OTHER_FRAMES:
            continue
        flat_deviation = abs(np.log(by_flat[band] / flat_median))
        reference_deviation = abs(np.log(by_reference[band] / reference_median))
        kind = "flat" if flat_deviation > reference_deviation else "reference"
        yield Suspicion(
            f"the {kind} of {band} is that of another band, or its exposure, aperture or image distance is wrong",
            f"{kind} ({band})",
            f"Flat over reference is {np.exp(difference):.3g} times that of the other bands, whose flats and "
            "references agree within 3%.",
        )


def _flats_deviate(constants: NDArray[np.float64], pair: tuple[int, int]) -> bool:
    """Whether two bands deviate from the others by their flats more than by their references.

    constants : (band, 2) logarithms of C by flats and by references.
    """
    apart = np.abs(constants - np.median(constants, axis=0))[list(pair)].sum(axis=0)
    return bool(apart[0] > apart[1])


def _exchanged_flats(ratio: NDArray[np.float64], level: NDArray[np.float64]) -> tuple[int, int] | None:
    """Indices of two bands with exchanged flats or references; None if there are none.

    ratio : logarithms of flat over reference. level : logarithms of the flats' means. All other bands agree, and the
    two do where each has the other's flat.
    """
    around = np.abs(ratio - np.median(ratio))
    first, second = sorted(int(index) for index in np.argsort(around)[-2:])
    others = np.delete(ratio, [first, second])
    difference = level[second] - level[first]
    undone = np.array([ratio[first] + difference, ratio[second] - difference]) - others.mean()
    remainder = max(SMALLEST_UNDONE, UNDONE_SPREADS * float(others.std(ddof=1)))
    apart = np.abs(ratio[[first, second]] - others.mean())
    agree = np.abs(others - others.mean()).max() < remainder and np.abs(undone).max() < remainder
    return (first, second) if agree and apart.min() > EXCHANGE_OVER_UNDONE * remainder else None


def _flat_constant(capture: Capture, table: FlatTable, mean_dn: float, channel: str | None) -> float | None:
    """C from a flat, if its field is the reference source; None if tables are incomplete."""
    references = capture.references(table.band)
    source = table.radiance or (references[0].radiance if references else None)
    unit = None if source is None else counts_over_constant(capture, table, source, channel)
    return mean_dn / unit if unit is not None and np.isfinite(mean_dn) else None


def check_focal_length(capture: Capture, fit: CameraFit | None) -> Iterator[Suspicion]:
    """Check the focal length fitted to the points against the nominal one.

    Parameters
    ----------
    capture
        A capture.
    fit
        Camera fitted to its surveyed points; None without one.

    Yields
    ------
    Suspicion
        If they differ by more than a fifth.
    """
    camera, focal = capture.manifest.camera, capture.manifest.lens.focal_length_mm
    if fit is None or focal is None or camera.pixel_pitch_um is None:
        return
    nominal = focal * 1e3 / camera.pixel_pitch_um
    ratio = fit.camera.focal_length_px / nominal
    if not 1 / LARGEST_FOCAL_RATIO < ratio < LARGEST_FOCAL_RATIO:
        yield Suspicion(
            "focal length or pixel pitch is wrong, or the points are those of another camera",
            "lens.focal_length_mm",
            f"The points show a focal length of {fit.camera.focal_length_px:.1f} px, the manifest {nominal:.1f} px: "
            f"{ratio:.3g} times as much.",
        )


def centre_nm(capture: Capture, band: BandTable) -> float:
    """Mean wavelength of a band's transmittance.

    Parameters
    ----------
    capture
        A capture.
    band
        One of its bands.

    Returns
    -------
    float
        nm; NaN if the transmittance is not stated.
    """
    if band.transmittance is None:
        return float("nan")
    transmittance = capture.light(band.transmittance).at(WAVELENGTH_NM)
    return float(np.sum(transmittance * WAVELENGTH_NM) / max(np.sum(transmittance), 1e-300))


def power_law(wavelength_nm: NDArray[np.float64], ratios: NDArray[np.float64]) -> int | None:
    """Power of the wavelength that ratios follow.

    Robust slope of logarithms (Theil 1950, Sen 1968).

    Parameters
    ----------
    wavelength_nm
        (n,) nm; NaN is left out.
    ratios
        (n,) ratios; values that are not positive are left out.

    Returns
    -------
    int or None
        1 or -1; None if the ratios follow neither, or if fewer than four are usable.
    """
    usable = np.isfinite(wavelength_nm) & np.isfinite(ratios) & (ratios > 0)
    if np.count_nonzero(usable) < 4 or np.ptp(wavelength_nm[usable]) == 0:
        return None
    x, y = np.log(wavelength_nm[usable]), np.log(ratios[usable])
    slope, offset = median_line(x, y)
    residual = np.abs(y - slope * x - offset)
    near = abs(abs(slope) - 1) < POWER_TOLERANCE and np.quantile(residual, STRAIGHT_SHARE) < STRAIGHT
    return int(np.sign(slope)) if near else None
