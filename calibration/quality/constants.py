"""Checks of the constant C against that of the nominal lens, and of bands, flats and references against each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from numpy.typing import NDArray
from scipy.stats import theilslopes

from ..capture import BandTable, Capture, FlatTable
from ..correction import CorrectedBands, NoiseModel
from ..geometry import CameraFit
from ..radiometry import Radiometry, counts_over_constant
from .suspicion import Suspicion

__all__ = [
    "centre_nm",
    "check_constant",
    "check_flats_and_references",
    "check_focal_length",
    "power_law",
]

#: Plausible range of C over its nominal value: stated apertures, gains and lenses are accurate to about 30%; light from
#: outside the pass band increases it.
_LOWEST, _HIGHEST = 1 / 1.45, 1.7
#: Plausible range of one band's C over the median of all: a leak of its filter increases it.
_LOWEST_BAND, _HIGHEST_BAND = 1 / 1.4, 20.0
#: Scatter (natural log) of the bands' C that counts as agreement, and the deviation of a single wrong reference.
_AGREE, _ALONE = 0.015, 0.12
#: Scatter of flat over reference between bands if both show the same field, and deviation of a wrong frame.
_SAME_FIELD, _OTHER_FRAMES = 0.03, 0.07
#: Flats may have a level of their own in each band; by chance a sixth of the bands agree with the median then. This
#: part of so many bands or more does with a chance of 1 %.
_MOST_AGREE, _FEWEST_BANDS = 0.7, 5
_FOCAL = 1.2
#: Largest distance of the power from 1 or -1, and of four fifths of the logarithms from the line.
_NEAR_ONE, _STRAIGHT = 0.2, 0.04


def _named_factors(capture: Capture, noise: NoiseModel, focal_px: float | None) -> list[tuple[float, str]]:
    """(C over nominal, mistake that causes this ratio)."""
    manifest = capture.manifest
    camera, focal = manifest.camera, manifest.lens.focal_length_mm
    factors = [
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
    ]
    f_number = manifest.band[0].f_number
    if focal is not None and f_number:
        factors.append((f_number**4 / focal**2, "an aperture's diameter in mm in place of the f-number"))
        factors.append(((focal / f_number**2) ** 2, "an f-number in place of something else"))
        if focal_px is not None and camera.pixel_pitch_um:
            other = focal_px * camera.pixel_pitch_um * 1e-3
            if not 1 / _FOCAL < other / focal < _FOCAL:
                factors.insert(0, ((other / focal) ** 2, f"a focal length of {other:.3g} mm, as the points show"))
                factors.insert(0, ((focal / other) ** 2, f"a pixel pitch {focal / other:.3g} times larger"))
    if noise.gain_e_per_dn and noise.gain_sigma is not None and camera.gain_e_per_dn:
        ratio = camera.gain_e_per_dn / noise.gain_e_per_dn
        if not 1 / 1.4 < ratio < 1.4:
            factors.insert(0, (ratio, f"a gain of {noise.gain_e_per_dn:.4g} e-/DN, as the noise shows"))
    return factors


def check_constant(
    capture: Capture,
    radiometry: Radiometry,
    noise: NoiseModel,
    fit: CameraFit | None,
    channels: Mapping[str, str] | None,
) -> Iterator[Suspicion]:
    """Checks C of the references against that of the nominal lens, and each band's C against their median."""
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
    focal_px = None if fit is None else fit.camera.focal_length_px
    if radiometry.nominal:
        ratio = median / radiometry.nominal
        if ratio <= 0 or not _LOWEST < ratio < _HIGHEST:
            named = _named_factors(capture, noise, focal_px)
            near = [text for factor, text in named if ratio > 0 and abs(np.log(ratio / factor)) < np.log(1.15)]
            guess = "; ".join(dict.fromkeys(near[:3])) or (
                "exposure, aperture, image distance, gain, pixel pitch, a transmittance or the source's radiance"
            )
            what = "a quantity of the sensor equation is in another unit or wrong"
            yield Suspicion(
                f"{what}: {guess}",
                "reference",
                f"The references give C = {median:.3g}, focal length, pixel area and gain {radiometry.nominal:.3g}: "
                f"{ratio:.3g} times as much.",
            )
    if len(constants) < 3 or median <= 0:
        return
    ratios = {c.band: c.constant / median for c in radiometry.by_band}
    exchanged = _exchanged(capture, ratios, channels)
    for band, ratio in ratios.items():
        if band in exchanged or not _LOWEST_BAND < ratio < _HIGHEST_BAND or _stands_alone(ratios, band):
            yield Suspicion(
                f"the references of {' and '.join(exchanged)} are exchanged"
                if band in exchanged
                else f"the reference of {band} does not suit its exposure, filter or quantum efficiency (frames or "
                "tables of another band)",
                f"reference ({band})",
                f"Its C is {ratio:.3g} times the median of the bands; C is one constant for all.",
            )


def _exchanged(capture: Capture, ratios: Mapping[str, float], channels: Mapping[str, str] | None) -> tuple[str, ...]:
    """Two bands whose C are off as their exchanged frames, with or without exposures, make them; all others agree."""
    off = {band: float(np.log(ratio)) for band, ratio in ratios.items() if ratio > 0}
    apart = [band for band in off if abs(off[band]) > 2 * _AGREE]
    if len(off) < 5 or len(apart) != 2:
        return ()
    tables = [capture.references(band)[0] for band in apart]
    units = np.array(
        [
            counts_over_constant(capture, table, table.radiance, channels[table.band] if channels else None) or np.nan
            for table in tables
        ]
    )
    first, second = (off[band] for band in apart)
    for counts in (units, units / [table.exposure_s for table in tables]):
        expected = np.log(counts[1] / counts[0])
        if max(abs(first - expected), abs(second + expected)) < max(_AGREE, 0.1 * abs(expected)):
            return tuple(apart)
    return ()


def _stands_alone(ratios: Mapping[str, float], band: str) -> bool:
    """One band's C below those of all others, which agree: a leak or a shutter changes several, and by degrees."""
    rest = [abs(np.log(ratio)) for other, ratio in ratios.items() if other != band and ratio > 0]
    agreeing = len(rest) >= 4 and max(rest) < _AGREE
    return agreeing and ratios[band] > 0 and float(np.log(ratios[band])) < -_ALONE


def _flat_constant(capture: Capture, table: FlatTable, mean_dn: float, channel: str | None) -> float | None:
    """C from a flat, assuming that its field is the reference source; None if tables are incomplete."""
    references = capture.references(table.band)
    source = table.radiance or (references[0].radiance if references else None)
    unit = None if source is None else counts_over_constant(capture, table, source, channel)
    return mean_dn / unit if unit is not None and np.isfinite(mean_dn) else None


def check_flats_and_references(
    capture: Capture, bands: CorrectedBands, radiometry: Radiometry, channels: Mapping[str, str] | None
) -> Iterator[Suspicion]:
    """Checks that the ratio of flat and reference is the same in all bands, if both show the same field."""
    by_reference = {c.band: c.constant for c in radiometry.by_band}
    by_flat = {}
    for band in capture.band_ids:
        tables = capture.flats(band)
        channel = None if channels is None else channels[band]
        constant = _flat_constant(capture, tables[0], bands.flats[band].mean_dn, channel) if tables else None
        if constant and constant > 0 and by_reference.get(band, 0) > 0:
            by_flat[band] = constant
    if len(by_flat) < _FEWEST_BANDS:
        return
    ratio = np.log([by_flat[band] / by_reference[band] for band in by_flat])
    off = ratio - np.median(ratio)
    if np.mean(np.abs(off) < _SAME_FIELD) < _MOST_AGREE:
        return
    flat_median, reference_median = (
        float(np.median(list(v.values()))) for v in (by_flat, {b: by_reference[b] for b in by_flat})
    )
    for band, left in zip(by_flat, off, strict=True):
        if abs(left) < _OTHER_FRAMES:
            continue
        flat_off = abs(np.log(by_flat[band] / flat_median))
        reference_off = abs(np.log(by_reference[band] / reference_median))
        kind = "flat" if flat_off > reference_off else "reference"
        yield Suspicion(
            f"the {kind} of {band} is that of another band, or its exposure, aperture or image distance is wrong",
            f"{kind} ({band})",
            f"Flat over reference is {np.exp(left):.3g} times that of the other bands, whose flats and references "
            "agree within 3%.",
        )


def check_focal_length(capture: Capture, fit: CameraFit | None) -> Iterator[Suspicion]:
    """Checks the focal length fitted to the points against the nominal one."""
    camera, focal = capture.manifest.camera, capture.manifest.lens.focal_length_mm
    if fit is None or focal is None or camera.pixel_pitch_um is None:
        return
    nominal = focal * 1e3 / camera.pixel_pitch_um
    ratio = fit.camera.focal_length_px / nominal
    if not 1 / _FOCAL < ratio < _FOCAL:
        yield Suspicion(
            "focal length or pixel pitch is wrong, or the points are those of another camera",
            "lens.focal_length_mm",
            f"The points show a focal length of {fit.camera.focal_length_px:.1f} px, the manifest {nominal:.1f} px: "
            f"{ratio:.3g} times as much.",
        )


def centre_nm(capture: Capture, band: BandTable) -> float:
    """The mean wavelength of a band's transmittance, nm; NaN if it is not stated."""
    if band.transmittance is None:
        return float("nan")
    transmittance = capture.light(band.transmittance).at(WAVELENGTH_NM)
    return float(np.sum(transmittance * WAVELENGTH_NM) / max(np.sum(transmittance), 1e-300))


def power_law(wavelength_nm: NDArray[np.float64], ratios: NDArray[np.float64]) -> int | None:
    """The power of the wavelength, 1 or -1, that ratios (n,) follow; None if they follow neither.

    Robust against one band in five (a leak, a wrong exposure).
    """
    good = np.isfinite(wavelength_nm) & np.isfinite(ratios) & (ratios > 0)
    if np.count_nonzero(good) < 4 or np.ptp(wavelength_nm[good]) == 0:
        return None
    x, y = np.log(wavelength_nm[good]), np.log(ratios[good])
    slope, offset, *_ = theilslopes(y, x)
    near = abs(abs(slope) - 1) < _NEAR_ONE and np.quantile(np.abs(y - slope * x - offset), 0.8) < _STRAIGHT
    return int(np.sign(slope)) if near else None
