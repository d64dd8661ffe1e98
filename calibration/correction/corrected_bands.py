"""The measured BandImages: all bands of a capture, corrected and masked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation

from ..capture import Capture, channel_mask
from ..instrument import Mask, band_images
from .correction import FlatField, correct, evaluate_variance, read_flat, with_mean_of_all_pixels
from .dark import DarkLibrary
from .defects import dead_pixels, hot_pixels, vignetted_pixels
from .noise import NoiseModel

__all__ = ["CorrectedBands", "correct_bands"]


@dataclass(frozen=True, eq=False)
class CorrectedBands(OwnMappings):
    """images : the BandImages of the capture, bands in the manifest's order.

    coefficients : (band, 3, y, x) of the variance, see evaluate_variance. flats : by band.
    notes : assumptions made, one sentence each.
    """

    images: xr.Dataset
    coefficients: NDArray[np.float64]
    flats: Mapping[str, FlatField]
    notes: tuple[str, ...]

    def predicted_variance(self, expected_signal: ArrayLike) -> NDArray[np.float64]:
        """Variance (band, y, x) in DN^2 of the signals, given their expectation (band, y, x) in DN."""
        return evaluate_variance(self.coefficients, expected_signal)


def _defects(
    capture: Capture, flat: FlatField, dark: DarkLibrary, noise: NoiseModel, exposure_s: float
) -> NDArray[np.uint8]:
    mask = np.zeros(capture.shape, np.uint8)
    if dark.exposure_s.size:
        smallest = float(np.sqrt(noise.floor_dn2 / dark.repeats.max()))
        mask[hot_pixels(dark.at(exposure_s), smallest)] |= np.uint8(Mask.HOT)
    if np.isfinite(flat.mean_dn):
        mask[dead_pixels(flat.response, capture.manifest.mosaic is not None)] |= np.uint8(Mask.DEAD)
        mask[vignetted_pixels(flat.response)] |= np.uint8(Mask.VIGNETTED)
    return mask


def _channel_masks(capture: Capture, channels: Mapping[str, str] | None) -> dict[str, NDArray[np.bool_] | None]:
    """(y, x) of each band, None without a mosaic."""
    bands, mosaic = capture.band_ids, capture.manifest.mosaic
    if channels is None or mosaic is None:
        return dict.fromkeys(bands)
    return {band: channel_mask(mosaic.pattern, capture.shape, channels[band]) for band in bands}


def correct_bands(
    capture: Capture, dark: DarkLibrary, noise: NoiseModel, channels: Mapping[str, str] | None = None
) -> CorrectedBands:
    """Every band's frames corrected by equation 1 of Pattanaik et al. 1997, with their variance and mask.

    SATURATED: a repeat or the flat reaches the saturation; with a mosaic also the eight neighbours, to which
    charge and interpolation spread. HOT and DEAD: see ``defects``. VIGNETTED: the flat is below a tenth of its
    maximum. The dataset's ``variance`` is computed from the measured signal; for a chi-square use
    ``predicted_variance``. channels : with a mosaic, the channel of each band (coordinate ``channel``); the
    pixels of the other channels are kept in the image.

    Raises InputError for a faulty frame.
    """
    manifest = capture.manifest
    corrected, masks, flats, notes = [], [], {}, []
    if capture.full_well_dn is not None:
        notes.append(
            f"pixels saturate at {capture.full_well_dn} DN, below the full scale of {capture.full_scale_dn} DN: there "
            "they have no more noise than in the dark; those are masked"
        )
    if not manifest.darks and manifest.dark != "subtracted":
        notes.append("no dark frames: a dark level of 0 was assumed")
    if manifest.dark == "subtracted":
        notes.append("the dark was subtracted beforehand: its noise is not included")
    if manifest.flat == "divided":
        notes.append("the flat was divided beforehand: its noise is not included, vignetting is not masked")
    without_flat = [band.id for band in manifest.band if not capture.flats(band.id)]
    if without_flat and manifest.flat != "divided":
        shown = ", ".join(without_flat)
        notes.append(f"no flat field for {shown}: vignetting and pixel sensitivity are not corrected")
    of_channel = _channel_masks(capture, channels)
    as_read = {band: read_flat(capture, band, dark, noise, channel) for band, channel in of_channel.items()}
    for band in manifest.band:
        alike = [as_read[other.id] for other in manifest.band if other.f_number == band.f_number]
        flat = with_mean_of_all_pixels(band.id, as_read[band.id], alike, of_channel[band.id])
        frames = correct(capture, band, flat, dark, noise)
        mask = _defects(capture, flat, dark, noise, band.exposure_s)
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
            "dark subtracted" if dark.exposure_s.size else "no dark subtracted",
            "flat divided" if manifest.flats else "no flat divided",
            *notes,
        ]
    )
    if channels is not None:
        images = images.assign_coords(channel=("band", [channels[band] for band in capture.band_ids]))
    return CorrectedBands(images, coefficients, flats, tuple(dict.fromkeys(notes)))
