"""A spectral cube from narrow filters, scaled by one spectroradiometer reading.

After Vora et al. (2001), section III-B: 31 interference filters of about 10 nm from 400 to 700 nm in front of a
monochrome CCD. A dark of equal exposure is subtracted from each image. One factor per band scales a uniform region to a
spectroradiometer's reading of it. Their largest errors came from misalignment between bands, which they did not
correct; here every band is registered to a reference band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import suggestion
from cboxlab.utils.numbers import whole_number_of
from cboxlab.utils.table import Table
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from ..capture import Capture
from ..correction import CorrectedBands
from ..instrument import Mask
from .registration import Registration, move, register

__all__ = ["HyperspectralCube", "as_scene", "hyperspectral_cube", "region_mask"]

#: Level of the main lobe of a filter, relative to its peak: its full width at half maximum.
_HALF_MAXIMUM = 0.5


@dataclass(frozen=True, eq=False)
class HyperspectralCube:
    """Spectral cube of a capture, with the scale and the registration of each band."""

    #: `radiance` and `standard_error` (y, x, wavelength), W m^-2 sr^-1 nm^-1, wavelengths ascending, and
    #: `scale_relative_sigma` (wavelength), common to all pixels of a band.
    cube: xr.Dataset
    #: n identifiers in the order of the wavelengths.
    bands: tuple[str, ...]
    #: (n,) radiance per DN, W m^-2 sr^-1 nm^-1 DN^-1.
    scale: NDArray[np.float64]
    #: (n,) relative standard deviation of `scale` by noise in the region, without the spectroradiometer's.
    scale_relative_sigma: NDArray[np.float64]
    #: n registrations to the reference band; the identity for that band.
    registrations: tuple[Registration, ...]
    #: Bands that could not be registered.
    notes: tuple[str, ...]

    def lines(self) -> list[str]:
        """Number and wavelengths of the bands, then notes.

        Returns
        -------
        list of str
            The sentences.
        """
        grid = self.cube["wavelength"].values
        head = (
            f"Spectral cube of {len(self.bands)} bands from {grid[0]:.1f} to {grid[-1]:.1f} nm, registered to "
            f"{self.cube.attrs['registered_to']}"
        )
        return [head, *(f"• {note}" for note in self.notes)]

    def tables(self) -> list[Table]:
        """Scale and registration of each band.

        Returns
        -------
        list of Table
            One table: wavelength, radiance per DN, its relative standard deviation, shift, magnification, correlation.
        """
        bands = zip(
            self.bands,
            self.cube["wavelength"].values,
            self.scale,
            self.scale_relative_sigma,
            self.registrations,
            strict=True,
        )
        rows = []
        for band, wavelength, scale, sigma, registration in bands:
            shift = registration.shift_px.round(2) + 0.0  # no -0.00
            row = (
                band,
                f"{wavelength:.1f}",
                f"{scale:.4g}",
                f"{100 * sigma:.2f}",
                f"{shift[0]:+.2f}",
                f"{shift[1]:+.2f}",
                f"{registration.magnification:.4f}",
                f"{registration.correlation:.3f}",
            )
            rows.append(row)
        columns = ("band", "nm", "L per DN", "± 1 σ, %", "u, px", "v, px", "size", "correlation")
        return [Table("Scale of each band, and its shift to the reference band", columns, tuple(rows))]


def _centre(capture: Capture, band: str) -> tuple[float, Spectrum]:
    """Centroid, nm, of the main lobe above half its maximum, and the complete transmittance."""
    reference = capture.band(band).transmittance
    if reference is None:
        raise InputError(
            capture.folder / "capture.toml",
            f"band {band} without transmittance",
            "one for every band",
            "The wavelength of a band is computed from its transmittance.",
        )
    curve = capture.light(reference)
    grid = np.arange(curve.wavelength_nm[0], curve.wavelength_nm[-1] + 0.25, 0.5)
    values = curve.at(grid)
    peak = int(np.argmax(values))
    above = values >= _HALF_MAXIMUM * values[peak]
    below_left = np.flatnonzero(~above[:peak])
    below_right = np.flatnonzero(~above[peak:])
    left = int(below_left[-1]) + 1 if below_left.size else 0
    right = peak + int(below_right[0]) if below_right.size else grid.size
    lobe = slice(left, right)
    return float(np.average(grid[lobe], weights=values[lobe])), curve


def _filter_mean(curve: Spectrum, reading: Spectrum) -> float:
    """Mean of the reading, weighted by the filter's transmittance."""
    grid = np.arange(curve.wavelength_nm[0], curve.wavelength_nm[-1] + 0.25, 0.5)
    weights = curve.at(grid)
    return float(np.sum(weights * reading.at(grid)) / np.sum(weights))


def region_mask(capture: Capture, region: str) -> NDArray[np.bool_]:
    """Pixels of a region: a rectangle or a label.

    Parameters
    ----------
    capture
        Capture whose frames or labels define the region.
    region
        "u0,v0,u1,v1" in pixels (both corners included), or the name of a label.

    Returns
    -------
    NDArray
        (y, x) True inside the region.

    Raises
    ------
    InputError
        For a rectangle that is not within the frame, a label without [labels], or an unknown label.
    """
    height, width = capture.shape
    if "," in region:
        corners = [number for part in region.split(",") if (number := whole_number_of(part)) is not None]
        u0, v0, u1, v1 = corners if len(corners) == region.count(",") + 1 == 4 else (-1, -1, -1, -1)
        if u0 < 0 or not (u0 <= u1 < width and 0 <= v0 <= v1 < height):
            raise InputError(
                "region",
                f"'{region}'",
                f"u0,v0,u1,v1 with 0 <= u0 <= u1 < {width} and 0 <= v0 <= v1 < {height}",
            )
        inside: NDArray[np.bool_] = np.zeros(capture.shape, bool)
        inside[v0 : v1 + 1, u0 : u1 + 1] = True
        return inside
    if capture.manifest.labels is None:
        raise InputError("region", f"'{region}' without [labels] in the capture", "u0,v0,u1,v1 in pixels")
    names = {label.name: label.label for label in capture.label_names()}
    if region not in names:
        raise InputError("region", f"'{region}'", f"one of {', '.join(names)}", suggestion(region, names))
    return np.asarray(capture.labels() == names[region], np.bool_)


def hyperspectral_cube(
    capture: Capture,
    bands: CorrectedBands,
    region: ArrayLike,
    reading: Spectrum,
    *,
    reference_band: str | None = None,
    aligned: bool = True,
) -> HyperspectralCube:
    """Spectral cube of the capture's bands.

    Pixels masked in a band, or outside its image, are NaN there. The standard error is that of single pixels; the
    smoothing by interpolation is ignored.

    Parameters
    ----------
    capture
        Capture with a transmittance for every band.
    bands
        The capture's corrected bands.
    region
        (y, x) True where the spectroradiometer measured, in pixels of the reference band.
    reading
        Radiance that was measured there, W m^-2 sr^-1 nm^-1.
    reference_band
        Band to which the others are registered; None selects the middle one by wavelength.
    aligned
        False to skip the registration.

    Returns
    -------
    HyperspectralCube
        Cube of radiance with scales, registrations and notes.

    Raises
    ------
    InputError
        For bands without transmittance, an unknown reference band, and a region of another shape, without usable pixels
        or without light.
    """
    inside = np.asarray(region, bool)
    if inside.shape != capture.shape or not np.any(inside):
        raise InputError("region", f"{int(inside.sum())} pixels of {inside.shape}", f"some of {capture.shape}")
    centres = {band: _centre(capture, band) for band in capture.band_ids}
    order = sorted(centres, key=lambda band: centres[band][0])
    reference = reference_band or order[len(order) // 2]
    if reference not in centres:
        raise InputError("reference band", reference, f"one of {', '.join(order)}")
    images = bands.images
    fixed = images["signal"].sel(band=reference).values
    planes, errors, scales, sigmas, moves, notes = [], [], [], [], [], []
    for band in order:
        image = images.sel(band=band)
        signal = image["signal"].values
        # Interpolation spreads a masked pixel: its neighbourhood is masked too.
        bad = image["mask"].values & np.uint8(Mask.SATURATED | Mask.HOT | Mask.DEAD) != 0
        registration = register(fixed, signal) if aligned and band != reference else _identity()
        if aligned and not registration.converged:
            notes.append(f"{band}: not registered: too few edges")
        filled = np.where(bad, np.median(signal), signal)
        out = move(bad.astype(float), registration, smooth=False)
        usable = np.nan_to_num(out, nan=1.0) < 0.01
        moved = np.where(usable, move(filled, registration), np.nan)
        variance = np.where(usable, move(image["variance"].values, registration, smooth=False), np.nan)
        level, count = float(np.nanmean(moved[inside])), int(usable[inside].sum())
        if count == 0 or not level > 0:
            raise InputError(f"region in band {band}", "no light" if count else "no usable pixel", "a lit region")
        scale = _filter_mean(centres[band][1], reading) / level
        planes.append(scale * moved)
        errors.append(scale * np.sqrt(variance))
        scales.append(scale)
        sigmas.append(float(np.sqrt(np.nansum(variance[inside]))) / count / level)
        moves.append(registration)
    dims, units = ("y", "x", "wavelength"), {"units": "W m^-2 sr^-1 nm^-1"}
    cube = xr.Dataset(
        {
            "radiance": (dims, np.stack(planes, axis=-1), units),
            "standard_error": (dims, np.stack(errors, axis=-1), units),
            "scale_relative_sigma": ("wavelength", np.array(sigmas)),
        },
        coords={"wavelength": ("wavelength", [centres[band][0] for band in order], {"units": "nm"})},
        attrs={
            "source": f"hyperspectral capture {capture.manifest.name}",
            "registered_to": reference,
            "missing": "NaN",
        },
    )
    return HyperspectralCube(cube, tuple(order), np.array(scales), np.array(sigmas), tuple(moves), tuple(notes))


def as_scene(cube: xr.Dataset) -> xr.Dataset:
    """Cube as input for a simulation: without NaN and without negative radiance.

    In each band, NaN pixels get the radiance of the nearest valid pixel, and negative radiances (from noise) are set to
    0. The standard error is unchanged: NaN marks the filled pixels.

    Parameters
    ----------
    cube
        Dataset with `radiance` (y, x, wavelength), W m^-2 sr^-1 nm^-1.

    Returns
    -------
    xr.Dataset
        Copy of the cube with another `radiance`.
    """
    radiance = cube["radiance"].values.copy()
    for band in range(radiance.shape[-1]):
        plane = radiance[..., band]
        rows, columns = distance_transform_edt(np.isnan(plane), return_distances=False, return_indices=True)
        radiance[..., band] = np.maximum(plane[rows, columns], 0.0)
    return cube.assign(radiance=(cube["radiance"].dims, radiance, cube["radiance"].attrs))


def _identity() -> Registration:
    """Registration of the reference band with itself."""
    return Registration(np.eye(2, 3), 1.0, np.zeros(2), 1.0, True)
