"""The measured BandImages: all bands of a capture, corrected and masked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation

from ..capture import Capture, channel_mask
from ..instrument import Mask, band_images
from .black_level import black_level
from .correction import FlatField, correct, evaluate_variance, read_flat, with_mean_of_all_pixels
from .dark import DarkLibrary
from .defects import dead_pixels, hot_pixels, vignetted_pixels
from .noise import NoiseModel

__all__ = ["CorrectedBands", "correct_bands"]


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


def _defects(
    capture: Capture,
    flat: FlatField,
    dark: DarkLibrary,
    noise: NoiseModel,
    exposure_s: float,
    channel: NDArray[np.bool_] | None,
) -> NDArray[np.uint8]:
    """(y, x) flags of defective, vignetted and other channels' pixels of one band."""
    mask = np.zeros(capture.shape, np.uint8)
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


def correct_bands(
    capture: Capture, dark: DarkLibrary, noise: NoiseModel, channels: Mapping[str, str] | None = None
) -> CorrectedBands:
    """Correct the frames of every band by equation 1 of Pattanaik et al. 1997.

    A pixel is masked as SATURATED if a repeat or the flat reaches the saturation. With a mosaic its eight neighbours
    are masked, too, because charge and interpolation spread to them. HOT and DEAD: see ``defects``. VIGNETTED: the
    flat is below a tenth of its maximum. OTHER_CHANNEL: with a mosaic, the pixels that the band does not see.

    The dataset's ``variance`` is computed from the measured signal. For a chi-square use ``predicted_variance``.

    Parameters
    ----------
    capture
        The capture whose bands are corrected.
    dark
        Its dark levels (see ``read_darks``).
    noise
        Noise model of one count (see ``measure_noise``).
    channels
        With a mosaic, the channel of each band, such as "R"; it becomes the coordinate ``channel``. The signals of the
        other channels' pixels stay in the image, masked. None without a mosaic.

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
    corrected, masks, flats, notes = [], [], {}, []
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
            "dark current and hot pixels are not corrected"
        )
    if manifest.dark == "subtracted":
        notes.append("the dark was subtracted beforehand: its noise is not included")
    if manifest.flat == "divided":
        notes.append("the flat was divided beforehand: its noise is not included, vignetting is not masked")
    without_flat = [band.id for band in manifest.band if not capture.flats(band.id)]
    if without_flat and manifest.flat != "divided":
        bands_without_flat = ", ".join(without_flat)
        notes.append(f"no flat field for {bands_without_flat}: vignetting and pixel sensitivity are not corrected")
    of_channel = _channel_masks(capture, channels)
    measured_flats = {band: read_flat(capture, band, dark, noise, channel) for band, channel in of_channel.items()}
    for band in manifest.band:
        same_aperture = [measured_flats[other.id] for other in manifest.band if other.f_number == band.f_number]
        flat = with_mean_of_all_pixels(band.id, measured_flats[band.id], same_aperture, of_channel[band.id])
        frames = correct(capture, band, flat, dark, noise)
        mask = _defects(capture, flat, dark, noise, band.exposure_s, of_channel[band.id])
        saturated = frames.saturated | flat.saturated
        if manifest.mosaic is not None:
            saturated = binary_dilation(saturated, np.ones((3, 3)))
        mask[saturated] |= np.uint8(Mask.SATURATED)
        corrected.append(frames)
        masks.append(mask)
        flats[band.id] = flat
        notes += [note for note in (flat.note, dark.note(band.exposure_s)) if note is not None]
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
            "flat divided" if manifest.flats else "no flat divided",
            *notes,
        ]
    )
    if channels is not None:
        images = images.assign_coords(channel=("band", [channels[band] for band in capture.band_ids]))
    return CorrectedBands(images, coefficients, flats, tuple(dict.fromkeys(notes)))
