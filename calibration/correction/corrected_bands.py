"""The measured BandImages: all bands of a capture, corrected and masked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation

from ..capture import BandTable, Capture, channel_mask, shares_frames
from ..instrument import Mask, band_images
from .black_level import black_level, dark_level_sigmas, fitted_dark_levels
from .correction import CorrectedFrames, FlatField, correct, evaluate_variance, read_flat, with_mean_of_all_pixels
from .dark import DarkLibrary
from .defects import dead_pixels, hot_pixels, lone_bright_pixels, vignetted_pixels
from .exposure_agreement import ExposureFinding, exposure_findings
from .exposure_merge import Exposure, MergedFrames, exposures_of, merge_exposures, merged_tables
from .noise import NoiseModel
from .nominal_fall_off import LensAxis, nominal_flat, with_pixel_scatter
from .picture_noise import pixel_scatter, scatter_of_residuals

__all__ = ["CorrectedBands", "correct_bands"]

#: Relative noise of a flat's pixel from which its channel sees too little light: dark pixels are then masked by chance.
_FAINT = 0.1
#: Largest scatter of sensitivities that is assumed before a comparison: sensors have 0.003 to 0.02. Edges of the scene
#: widen its estimate, most where neighbours of one channel are far apart.
_LARGEST_FIRST_SCATTER = 0.02
#: Smallest counts of a channel over those of the brightest one in its frames for which its scale counts: crosstalk of
#: 1 % is a fifth of less.
_SMALLEST_SHARE_OF_LIGHT = 0.05


@dataclass(frozen=True, eq=False)
class CorrectedBands(FrozenMappings):
    """Corrected band images of a capture with the terms of their variance."""

    #: BandImages of the capture: signal and variance (DN, DN^2) and mask, bands in the manifest's order.
    images: xr.Dataset
    #: (band, 3, y, x) coefficients of the variance as a quadratic in the expected signal, see ``evaluate_variance``.
    coefficients: NDArray[np.float64]
    #: By band identifier, the flat field by which its frames were divided.
    flats: Mapping[str, FlatField]
    #: Assumptions of the correction, one sentence each, without repetition.
    notes: tuple[str, ...]
    #: Axis of the lens whose nominal fall-off stands for flats that were not taken; None where it does not.
    nominal_axis: LensAxis | None = None
    #: Relative standard deviation of the pixels' sensitivities, in the variance where no flats were taken, else 0.
    pixel_scatter: float = 0.0
    #: (band,) standard deviations of the bands' dark levels where no darks measured them, DN; 0 or empty with darks.
    dark_sigma_dn: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    #: (band,) dark levels that a comparison subtracted in addition, DN.
    further_dark_dn: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    #: (band,) standard deviations of the dark levels that remain after it, DN.
    further_dark_sigma_dn: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    #: Standard deviation of the pixels' dark levels, in the variance where no darks were taken, DN; else 0.
    dark_scatter_dn: float = 0.0
    #: By band of several exposures, how they were merged.
    merged: Mapping[str, MergedFrames] = field(default_factory=dict)
    #: Stated exposure times that do not fit the counts; where one is at fault, it was left out.
    exposure_findings: tuple[ExposureFinding, ...] = ()
    #: Bands of a mosaic's channels that see too little of their filter's light, next to others of the same frames.
    faint: frozenset[str] = frozenset()

    @property
    def by_dark_level(self) -> NDArray[np.float64]:
        """(band, y, x) change of the signals by a dark level of 1 DN, without unit."""
        return np.stack([1 / self.flats[band].response for band in self.images.band.values])

    @property
    def dark_changes(self) -> NDArray[np.float64]:
        """(band, band, y, x) changes of the signals by a standard deviation of each dark level, DN."""
        return np.asarray(np.diag(self.dark_sigma_dn)[:, :, None, None] * self.by_dark_level)

    @property
    def dark_sentence(self) -> str | None:
        """The dark levels that a comparison fitted, and what is not seen then; None with darks."""
        if not self.dark_sigma_dn.any() or not self.further_dark_dn.size:
            return None
        triples = zip(self.images.band.values, self.further_dark_dn, self.further_dark_sigma_dn, strict=True)
        levels = ", ".join(f"{band} {level:+.2g} (± {sigma:.2g})" for band, level, sigma in triples)
        hot = int(np.count_nonzero(np.any(self.images["mask"].values & Mask.HOT, axis=0)))
        return (
            f"No darks were taken: the bands' dark levels are fitted about the stated ones, in DN: {levels}. A dark "
            f"offset or a glare of that size is not seen; photograph with the lens covered. Hot pixels left out: {hot}."
        )

    def _scattering(self, signal: NDArray[np.float64]) -> tuple[list[NDArray[np.float64]], NDArray[np.float64]]:
        """Signals (band, y, x) by one unit of what scatters unseen, and its sizes."""
        shapes, sizes = [], []
        if self.nominal_axis is not None:
            shapes, sizes = [signal], [self.pixel_scatter]
        if self.dark_sigma_dn.any():
            shapes, sizes = [*shapes, self.by_dark_level], [*sizes, self.dark_scatter_dn]
        return shapes, np.array(sizes)

    def shared_variance(self, expected_signal: ArrayLike) -> NDArray[np.float64]:
        """Further variance by which the bands' errors of a pixel count as independent.

        Without flats all bands of a pixel have the same unknown sensitivity, without darks the same dark level. The
        variance times the number of bands that see the pixel gives a change of all bands its right uncertainty, and one
        of a single band too large a one.

        Parameters
        ----------
        expected_signal
            (band, y, x) expectation of the corrected signals, DN.

        Returns
        -------
        NDArray
            (band, y, x) variance in addition to ``predicted_variance``, DN^2; 0 with flats and darks.
        """
        bands_of_pixel = np.sum(self.images["mask"].values == 0, axis=0)
        signal = np.asarray(expected_signal, float)
        variance = (self.pixel_scatter * signal) ** 2
        if self.dark_scatter_dn:
            variance = variance + (self.dark_scatter_dn * self.by_dark_level) ** 2
        return np.maximum(bands_of_pixel - 1, 0) * variance

    def with_scatter_of(
        self,
        expected_signal: NDArray[np.float64],
        variance: NDArray[np.float64],
        used: NDArray[np.bool_],
        cell: tuple[int, int],
    ) -> CorrectedBands:
        """Bands with the pixels' scatter by a comparison; unchanged with flats and darks.

        Without flats sensitivities scatter, without darks the dark levels.

        Parameters
        ----------
        expected_signal
            (band, y, x) rendered signals, DN.
        variance
            (band, y, x) variance of measured minus rendered, DN^2, with the scatter so far.
        used
            (band, y, x) True for the samples used.
        cell
            (rows, columns) of one repeat of the mosaic, px; (1, 1) without one.

        Returns
        -------
        CorrectedBands
            With scatter, flat fields and variances changed.
        """
        signal = self.images["signal"].values
        shapes, before = self._scattering(expected_signal)
        if not shapes:
            return self
        so_far = sum(size**2 * shape**2 for size, shape in zip(before, shapes, strict=True))
        scatter = scatter_of_residuals(signal, expected_signal, variance - so_far, used, shapes, cell)
        if not np.isfinite(scatter).all():
            return self
        coefficients, flats, images = self.coefficients.copy(), dict(self.flats), self.images.copy()
        of_pixels, of_darks, further = self.pixel_scatter, self.dark_scatter_dn, scatter**2 - before**2
        if self.nominal_axis is not None:
            of_pixels = float(scatter[0])
            coefficients[:, 2] += further[0]
            flats = {band: with_pixel_scatter(flat, of_pixels) for band, flat in flats.items()}
        if self.dark_sigma_dn.any():
            of_darks = float(scatter[-1])
            coefficients[:, 0] += further[-1] * shapes[-1] ** 2
        images["variance"] = self.images["variance"] + evaluate_variance(coefficients - self.coefficients, signal)
        return replace(
            self,
            images=images,
            coefficients=coefficients,
            flats=flats,
            pixel_scatter=of_pixels,
            dark_scatter_dn=of_darks,
        )

    def with_dark_levels_of(
        self, expected_signal: NDArray[np.float64], variance: NDArray[np.float64], used: NDArray[np.bool_]
    ) -> CorrectedBands:
        """Bands whose dark levels are fitted to a comparison, where no darks measured them.

        Hot pixels, which no darks show, are masked.

        Parameters
        ----------
        expected_signal
            (band, y, x) rendered signals, DN.
        variance
            (band, y, x) variance of measured minus rendered, DN^2.
        used
            (band, y, x) True for the samples used.

        Returns
        -------
        CorrectedBands
            With signals and masks changed; unchanged with darks.
        """
        if not self.dark_sigma_dn.any():
            return self
        images, by_level = self.images.copy(), self.by_dark_level
        signal = self.images["signal"].values
        if self.further_dark_dn.size:
            signal = signal + self.further_dark_dn[:, None, None] * by_level
        levels, sigmas = fitted_dark_levels(
            signal, by_level, self.dark_sigma_dn, signal=expected_signal, variance=variance, used=used
        )
        signal = signal - levels[:, None, None] * by_level
        images["signal"] = self.images["signal"].copy(data=signal)
        pull, bands = np.where(used, (signal - expected_signal) / np.sqrt(variance), 0.0), used.sum(axis=0)
        pull_of_bands = np.where(bands > 0, pull.sum(axis=0) / np.sqrt(np.maximum(bands, 1)), np.nan)
        hot = np.where(lone_bright_pixels(pull_of_bands), np.uint8(Mask.HOT), np.uint8(0))
        images["mask"] = self.images["mask"] | hot
        return replace(self, images=images, further_dark_dn=levels, further_dark_sigma_dn=sigmas)

    def predicted_variance(self, expected_signal: ArrayLike) -> NDArray[np.float64]:
        """Variance of the corrected signals, given their expectation.

        This variance does not depend on the measured noise, so it suits a chi-square.

        Parameters
        ----------
        expected_signal
            (band, y, x) expectation of the corrected signals, DN; negative values count as 0.

        Returns
        -------
        NDArray
            (band, y, x) variance of the mean over repeats, DN^2.
        """
        return evaluate_variance(self.coefficients, expected_signal)

    def variance_sigma(
        self, expected_signal: ArrayLike, variance: ArrayLike, used: NDArray[np.bool_], noise: NoiseModel
    ) -> float:
        """Relative error that all variances have in common, since gain and read noise are measured.

        Parameters
        ----------
        expected_signal
            (band, y, x) expectation of the corrected signals, DN.
        variance
            (band, y, x) variance of the compared differences, DN^2: ``predicted_variance`` and what else they have.
        used
            (band, y, x) True for samples compared.
        noise
            Noise model of the bands.

        Returns
        -------
        float
            Standard deviation, relative, of a reduced chi-square by this error alone; 0 without samples.
        """
        if not used.any():
            return 0.0
        signal = np.maximum(np.asarray(expected_signal, float), 0.0)[used]
        total = np.asarray(variance, float)[used]
        c0, c1, c2 = (each[used] for each in np.moveaxis(self.coefficients, -3, 0))
        with_light = signal * (c1 + signal * (c2 - self.pixel_scatter**2))
        if self.dark_scatter_dn:
            c0 = c0 - (self.dark_scatter_dn * self.by_dark_level[used]) ** 2
        return noise.relative_sigma(float(np.mean(c0 / total)), float(np.mean(with_light / total)))


def _defects(
    capture: Capture,
    flat: FlatField,
    dark: DarkLibrary,
    noise: NoiseModel,
    exposure_s: float,
    channel: NDArray[np.bool_] | None,
) -> NDArray[np.uint8]:
    """(y, x) flags of defective, vignetted, excluded and other channels' pixels of one band."""
    mask = np.where(capture.excluded_pixels(), np.uint8(Mask.EXCLUDED), np.uint8(0))
    if dark.exposure_s.size:
        smallest = float(np.sqrt(noise.floor_dn2 / dark.repeats.max()))
        mask[hot_pixels(dark.at(exposure_s), smallest)] |= np.uint8(Mask.HOT)
    if np.isfinite(flat.mean_dn):
        mask[dead_pixels(flat.response, capture.cell or (1, 1), channel)] |= np.uint8(Mask.DEAD)
        mask[vignetted_pixels(flat.response, channel)] |= np.uint8(Mask.VIGNETTED)
    if channel is not None:
        mask[~channel] |= np.uint8(Mask.OTHER_CHANNEL)
    return mask


def _channel_masks(capture: Capture, channels: Mapping[str, str] | None) -> dict[str, NDArray[np.bool_] | None]:
    """By band, (y, x) True for the pixels of its channel; None without a mosaic."""
    bands, mosaic = capture.band_ids, capture.manifest.mosaic
    if channels is None or mosaic is None:
        return dict.fromkeys(bands)
    return {band: channel_mask(mosaic.pattern, capture.shape, channels[band]) for band in bands}


def _faint_bands(
    capture: Capture,
    channels: Mapping[str, str] | None,
    flats: Mapping[str, FlatField],
    of_channel: Mapping[str, NDArray[np.bool_] | None],
) -> frozenset[str]:
    """Bands whose flat is noise or stray light next to another channel of the same frames.

    What crosstalk and stray light bring from the brightest channel is no light of the band's own response.
    """
    clear, level = [], {band: flat.mean_dn for band, flat in flats.items()}
    for band, flat in flats.items():
        pixels = of_channel[band]
        spread = flat.relative_variance if pixels is None else flat.relative_variance[pixels]
        if float(np.median(spread)) <= _FAINT**2:
            clear.append(band)
    return frozenset(
        band
        for band in flats
        if any(
            shares_frames(capture, channels, band, other)
            and (band not in clear or level[band] < _SMALLEST_SHARE_OF_LIGHT * level[other])
            for other in clear
        )
    )


def _nominal_flats(
    capture: Capture, axis: LensAxis, dark: DarkLibrary, noise: NoiseModel, of_channel: Mapping[str, NDArray | None]
) -> tuple[dict[str, FlatField], float]:
    """Nominal flat fields by band, and the scatter of the pixels' sensitivities in them."""
    flat = nominal_flat(axis, capture.shape, dark)
    scatters = []
    for band in capture.manifest.band:
        frames = correct(capture, band, flat, dark, noise)
        variance = evaluate_variance(frames.coefficients, frames.signal)
        in_channel = of_channel[band.id]
        usable = ~frames.saturated if in_channel is None else ~frames.saturated & in_channel
        scatters.append(pixel_scatter(frames.signal, variance, usable, capture.cell or (1, 1)))
    finite = [scatter for scatter in scatters if np.isfinite(scatter)]
    scatter = min(float(np.median(finite)), _LARGEST_FIRST_SCATTER) if finite else _LARGEST_FIRST_SCATTER
    return dict.fromkeys(capture.band_ids, with_pixel_scatter(flat, scatter)), scatter


def _longest(capture: Capture, band: BandTable) -> float:
    """Longest exposure that is merged into a band, s."""
    return max(table.exposure_s for table in merged_tables(capture, band))


def _without_misfits(
    exposures: Sequence[Exposure], findings: Sequence[ExposureFinding], band: str
) -> tuple[Exposure, ...]:
    """The exposures of a band with times that fit each other.

    The band's own one alone remains where the fault is not certain. It always stays, since its time is that of the
    signal.
    """
    wrong = [finding.index for finding in findings if finding.band == band]
    if None in wrong or 0 in wrong:
        return (exposures[0],)
    return tuple(exposure for index, exposure in enumerate(exposures) if index not in wrong)


def _frame_notes(capture: Capture) -> list[str]:
    """Notes on early saturation, missing darks, and corrections made beforehand."""
    manifest, notes = capture.manifest, []
    if capture.full_well_dn is not None:
        notes.append(
            f"pixels saturate at {capture.full_well_dn} DN, below the full scale of {capture.full_scale_dn} DN: there "
            "they have no more noise than in the dark; those are masked"
        )
    if not manifest.darks and manifest.dark != "subtracted":
        black = black_level(capture)
        notes.append(
            "no dark frames: a dark level of 0 was assumed"
            if black is None
            else f"no dark frames: the black level of {black.text} was subtracted, known to {black.sigma_dn:.2g} DN; "
            "a model fits its error and dark current, and shows hot pixels"
        )
    if manifest.dark == "subtracted":
        notes.append("the dark was subtracted beforehand: its noise is not included")
    if manifest.flat == "divided":
        notes.append("the flat was divided beforehand: its noise is not included, vignetting is not masked")
    return notes


def _flat_fields(
    capture: Capture,
    dark: DarkLibrary,
    noise: NoiseModel,
    of_channel: Mapping[str, NDArray[np.bool_] | None],
    nominal_axis: LensAxis | None,
) -> tuple[dict[str, FlatField], float, list[str]]:
    """Flat field of each band, relative scatter of the pixels where it is nominal, and notes."""
    manifest, scatter, notes = capture.manifest, 0.0, []
    if nominal_axis is None:
        measured = {band: read_flat(capture, band, dark, noise, channel) for band, channel in of_channel.items()}
        without_flat = [band for band in capture.band_ids if not capture.flats(band)]
        if without_flat and manifest.flat != "divided":
            bands_without_flat = ", ".join(without_flat)
            notes.append(f"no flat field for {bands_without_flat}: vignetting and pixel sensitivity are not corrected")
    else:
        measured, scatter = _nominal_flats(capture, nominal_axis, dark, noise, of_channel)
        notes.append(
            "no flat fields: the fall-off is nominal, cos^4 of the field angle, and pixels' sensitivities scatter by "
            f"{scatter:.2%} (estimated from neighbours); what a lens falls off further is fitted with a model"
        )
    flats = {}
    for band in manifest.band:
        same_aperture = [measured[other.id] for other in manifest.band if other.f_number == band.f_number]
        flats[band.id] = with_mean_of_all_pixels(band.id, measured[band.id], same_aperture, of_channel[band.id])
    return flats, scatter, notes


def _corrected_frames(
    capture: Capture,
    flats: Mapping[str, FlatField],
    dark: DarkLibrary,
    noise: NoiseModel,
    defects: Mapping[str, NDArray[np.uint8]],
) -> tuple[list[CorrectedFrames], dict[str, MergedFrames], tuple[ExposureFinding, ...]]:
    """Frames of each band, with merged exposures and those whose times do not fit."""
    exposures = {
        band.id: exposures_of(capture, merged_tables(capture, band), flats[band.id], dark, noise)
        for band in capture.manifest.band
        if len(merged_tables(capture, band)) > 1
    }
    cell = capture.cell or (1, 1)
    findings = exposure_findings(exposures, {band: mask == 0 for band, mask in defects.items()}, cell)
    merged = {band: merge_exposures(_without_misfits(each, findings, band), cell) for band, each in exposures.items()}
    frames = [
        merged[band.id].frames if band.id in merged else correct(capture, band, flats[band.id], dark, noise)
        for band in capture.manifest.band
    ]
    return frames, {band: each for band, each in merged.items() if len(each.tables) > 1}, findings


def correct_bands(
    capture: Capture,
    dark: DarkLibrary,
    noise: NoiseModel,
    channels: Mapping[str, str] | None = None,
    nominal_axis: LensAxis | None = None,
) -> CorrectedBands:
    """Correct the frames of every band by equation 1 of Pattanaik et al. 1997.

    Several exposures of a band are merged, see ``exposure_merge``. A pixel is masked as SATURATED if a repeat reaches
    the saturation, in all exposures where there are several, or if the flat does. With a mosaic its eight neighbours
    are masked, too, because charge and interpolation spread to them. HOT and DEAD: see ``defects``. VIGNETTED: the
    flat is below a tenth of its maximum. OTHER_CHANNEL: with a mosaic, the pixels that the band does not see.

    The dataset's ``variance`` is computed from the measured signal. For a chi-square use ``predicted_variance``.

    Parameters
    ----------
    capture
        The capture whose bands are corrected.
    dark
        The capture's dark levels (see ``read_darks``).
    noise
        Noise model of one count (see ``measure_noise``).
    channels
        With a mosaic, the channel of each band, such as "R"; it becomes the coordinate ``channel``. The signals of the
        other channels' pixels stay in the image, masked. None without a mosaic.
    nominal_axis
        Axis of the lens, whose cosine-fourth fall-off takes the place of flats where no band has one; None for a
        uniform field in their place.

    Returns
    -------
    CorrectedBands
        All bands in the manifest's order.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    manifest = capture.manifest
    masks, notes, of_channel = [], _frame_notes(capture), _channel_masks(capture, channels)
    if manifest.flat == "divided" or any(capture.flats(band) for band in capture.band_ids):
        nominal_axis = None
    flats, scatter, flat_notes = _flat_fields(capture, dark, noise, of_channel, nominal_axis)
    notes += flat_notes
    defects = {
        band.id: _defects(capture, flats[band.id], dark, noise, _longest(capture, band), of_channel[band.id])
        for band in manifest.band
    }
    corrected, merged, findings = _corrected_frames(capture, flats, dark, noise, defects)
    for band, frames in zip(manifest.band, corrected, strict=True):
        flat, mask = flats[band.id], defects[band.id]
        saturated = frames.saturated | flat.saturated
        if manifest.mosaic is not None:
            saturated = binary_dilation(saturated, np.ones((3, 3)))
        mask[saturated] |= np.uint8(Mask.SATURATED)
        masks.append(mask)
        notes += [note for note in (flat.note, dark.note(band.exposure_s)) if note is not None]
    faint = _faint_bands(capture, channels, flats, of_channel)
    if faint:
        notes.append(
            f"{', '.join(band for band in capture.band_ids if band in faint)}: these channels see too little through "
            "their filters; the scale and the checks of frames leave them out"
        )
    if merged:
        times = "; ".join(
            f"{band}: {', '.join(f'{table.exposure_s:g}' for table in each.tables)} s" for band, each in merged.items()
        )
        notes.append(f"exposures were merged, each pixel from those in which it is not saturated ({times})")
    signal = np.stack([frames.signal for frames in corrected])
    coefficients = np.stack([frames.coefficients for frames in corrected])
    variance = evaluate_variance(coefficients, signal)
    images = band_images(capture.band_ids, signal, variance, np.stack(masks))
    images.attrs["reduction"] = "; ".join(
        [
            "repeats averaged",
            "dark subtracted"
            if dark.exposure_s.size
            else "black level subtracted"
            if dark.bias.any()
            else "no dark subtracted",
            "flat divided" if manifest.flats else "nominal fall-off divided" if nominal_axis else "no flat divided",
            *notes,
        ]
    )
    if channels is not None:
        images = images.assign_coords(channel=("band", [channels[band] for band in capture.band_ids]))
    return CorrectedBands(
        images,
        coefficients,
        flats,
        tuple(dict.fromkeys(notes)),
        nominal_axis,
        scatter,
        dark_level_sigmas(capture, capture.manifest.band, noise.shot_dn),
        merged=merged,
        exposure_findings=findings,
        faint=faint,
    )
