"""Comparison of measured and rendered images: residuals, colour differences, maps, tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from cboxlab.calibration.instrument import Mask
from cboxlab.utils.distributions import chi2_tail, fisher_tail
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import ArrayLike, NDArray

from .colour_difference import (
    COLOUR_DIFFERENCES,
    NOISE_SEED,
    DifferenceStatistics,
    White,
    expected_from_noise,
    lab,
    statistics,
)
from .pixel_colours import pixel_colours
from .regions import INTERIOR_DISTANCE_PX, edge_distance_px

__all__ = ["BandRow", "ChiSquare", "Comparison", "Expectation", "RelativeDifference", "SurfaceRow", "compare"]

#: Dimensions of the maps over samples.
_SAMPLES = ("band", "y", "x")
#: Dimensions of the maps over pixels.
_PIXELS = ("y", "x")


@dataclass(frozen=True)
class Expectation:
    """Properties of fit and noise that determine the expected chi2."""

    #: Number of fitted parameters, subtracted from the degrees of freedom.
    fitted_parameters: int = 0
    #: Relative standard deviation of the noise's variance, common to all residuals.
    variance_sigma: float = 0.0


#: The noise is known exactly and nothing was fitted.
_EXACT = Expectation()


@dataclass(frozen=True)
class ChiSquare:
    """Sum of squared residuals over sigma, and its expectation from noise.

    Where the variance of the noise is itself measured, with a relative error s common to all residuals, it is that of
    2 / s^2 degrees of freedom. The sum over its degrees of freedom then has Fisher's distribution.
    """

    #: The sum.
    value: float
    #: Number of residuals.
    count: int
    #: Degrees of freedom: the count minus its share of the fitted parameters.
    dof: float
    #: Relative standard deviation of the noise's variance, common to all residuals; 0 where it is exact.
    variance_sigma: float = 0.0

    @property
    def per_dof(self) -> float:
        """Reduced chi-square: 1 is expected from noise; NaN without pixels."""
        return self.value / self.dof if self.dof > 0 else float("nan")

    @property
    def per_dof_sigma(self) -> float:
        """Standard deviation of ``per_dof`` from noise, sqrt(2 / dof + variance_sigma^2)."""
        return float(np.hypot(np.sqrt(2.0 / self.dof), self.variance_sigma)) if self.dof > 0 else float("nan")

    @property
    def p_value(self) -> float:
        """Probability of a value at least as large from noise alone."""
        if not self.dof > 0:
            return float("nan")
        if self.variance_sigma == 0:
            return float(chi2_tail(self.value, self.dof))
        return float(fisher_tail(self.per_dof, self.dof, 2 / self.variance_sigma**2))

    @property
    def excess(self) -> float:
        """Value minus its expectation from noise; it can be negative."""
        return self.value - self.dof


@dataclass(frozen=True)
class RelativeDifference:
    """Relative difference (measured - rendered) / rendered over pixels; NaN without pixels."""

    #: Mean over the pixels.
    mean: float
    #: Root of the mean square over the pixels.
    rms: float
    #: The same root expected from noise alone.
    rms_noise: float


@dataclass(frozen=True)
class BandRow:
    """Comparison of one band."""

    #: Chi2 of all its residuals.
    chi2: ChiSquare
    #: Relative difference over pixels of surfaces.
    relative: RelativeDifference
    #: Root mean square difference beyond noise, over the rms rendered signal.
    beyond_noise: float


@dataclass(frozen=True, eq=False)
class SurfaceRow(FrozenMappings):
    """Comparison of one surface; means over its interior are NaN without interior pixels."""

    #: Chi2 of all its residuals, edges included.
    chi2: ChiSquare
    #: Number of interior pixels.
    interior_pixels: int
    #: (band,) mean measured signal, DN.
    measured: NDArray[np.float64]
    #: (band,) mean rendered signal, DN.
    rendered: NDArray[np.float64]
    #: (band,) standard error of the difference of the means, DN.
    sigma: NDArray[np.float64]
    #: (band,) difference of the means over the rendered mean.
    relative: NDArray[np.float64]
    #: (band,) standard error of the relative difference.
    relative_sigma: NDArray[np.float64]
    #: Differences between the colours of the means, by identifier.
    colour: Mapping[str, float]
    #: Mean of these differences expected from noise alone.
    colour_noise: Mapping[str, float]
    #: (3,) X, Y, Z of the measured means, Y in cd m^-2.
    xyz_measured: NDArray[np.float64]
    #: (3,) X, Y, Z of the rendered means, Y in cd m^-2.
    xyz_rendered: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Comparison(FrozenMappings):
    """Outcome of one comparison; immutable.

    Behind a mosaic measured, rendered and sigma are those of all pixels, also of those that a band does not see. XYZ
    and the maps of colour and luminance are those of whole cells (see ``compare``). Pixels of a mosaic's other channels
    do not count as masked.
    """

    #: Names of the bands.
    bands: tuple[str, ...]
    #: (band, y, x) measured, rendered, sigma (DN), residual_over_sigma, mask; (y, x, xyz) xyz_measured, xyz_rendered;
    #: (y, x) each of COLOUR_DIFFERENCES, luminance_relative_difference, surface, edge_distance_px. NaN where a pixel is
    #: left out, except for signals and XYZ.
    maps: xr.Dataset
    #: (3, band) X, Y, Z per count.
    xyz_per_dn: NDArray[np.float64]
    #: White of CIELab.
    white: White
    #: Chi2 of all residuals.
    chi2: ChiSquare
    #: Chi2 near edges.
    chi2_edges: ChiSquare
    #: Chi2 of interiors.
    chi2_interiors: ChiSquare
    #: Share of the excess chi2 near edges, 0 to 1; NaN without excess.
    share_of_excess_at_edges: float
    #: Comparison by band.
    by_band: Mapping[str, BandRow]
    #: Comparison by surface.
    by_surface: Mapping[str, SurfaceRow]
    #: Colour differences of pixels of surfaces, by identifier.
    colour: Mapping[str, DifferenceStatistics]
    #: The same expected from noise alone.
    colour_noise: Mapping[str, DifferenceStatistics]
    #: Relative difference of luminance.
    luminance: RelativeDifference
    #: Median ratio of the rendering's to the sensor's standard deviation.
    render_sigma_over_sensor_sigma: float
    #: Pixels used in every band.
    pixels_used: int
    #: Pixels left out in at least one band, by reason; a pixel may have several reasons.
    masked: Mapping[str, int]
    #: (height, width) of one repeat of the sensor's mosaic, px; None without a mosaic.
    cell: tuple[int, int] | None = None


def _relative(
    measured: NDArray[np.float64],
    rendered: NDArray[np.float64],
    variance: NDArray[np.float64],
    where: NDArray[np.bool_],
) -> RelativeDifference:
    r = rendered[where & (rendered > 0)]
    if r.size == 0:
        return RelativeDifference(np.nan, np.nan, np.nan)
    ratio = measured[where & (rendered > 0)] / r - 1.0
    noise = variance[where & (rendered > 0)] / r**2
    return RelativeDifference(float(ratio.mean()), float(np.sqrt(np.mean(ratio**2))), float(np.sqrt(noise.mean())))


def _surface(
    chi2: ChiSquare,
    inside: NDArray[np.bool_],
    measured: NDArray[np.float64],
    rendered: NDArray[np.float64],
    variance: NDArray[np.float64],
    *,
    used: NDArray[np.bool_] | None,
    xyz_per_dn: NDArray[np.float64],
    white: White,
) -> SurfaceRow:
    """Row of a surface from its interior; behind a mosaic from each band's ``used`` pixels."""
    n = int(inside.sum())
    pixels = None if used is None else (inside & used).sum(axis=(1, 2))
    if n == 0 or (pixels is not None and not pixels.all()):
        no_signal, no_light = np.full(measured.shape[0], np.nan), np.full(3, np.nan)
        no_colour = dict.fromkeys(COLOUR_DIFFERENCES, float("nan"))
        return SurfaceRow(
            chi2,
            0,
            measured=no_signal,
            rendered=no_signal,
            sigma=no_signal,
            relative=no_signal,
            relative_sigma=no_signal,
            colour=no_colour,
            colour_noise=no_colour,
            xyz_measured=no_light,
            xyz_rendered=no_light,
        )
    if used is None or pixels is None:
        mean_measured, mean_rendered = measured[:, inside].mean(axis=1), rendered[:, inside].mean(axis=1)
        sigma = np.sqrt(variance[:, inside].sum(axis=1)) / n
    else:
        n = int((inside & used).any(axis=0).sum())
        sums = [np.where(inside & used, image, 0.0).sum(axis=(1, 2)) for image in (measured, rendered, variance)]
        mean_measured, mean_rendered, sigma = sums[0] / pixels, sums[1] / pixels, np.sqrt(sums[2]) / pixels
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(mean_rendered > 0, mean_measured / mean_rendered - 1.0, np.nan)
        relative_sigma = np.where(mean_rendered > 0, sigma / mean_rendered, np.nan)
    xyz_measured, xyz_rendered = xyz_per_dn @ mean_measured, xyz_per_dn @ mean_rendered
    lab_measured, lab_rendered = lab(xyz_measured, white), lab(xyz_rendered, white)
    noise = expected_from_noise(mean_rendered[:, None], sigma[:, None], xyz_per_dn, white, NOISE_SEED)
    return SurfaceRow(
        chi2,
        n,
        mean_measured,
        mean_rendered,
        sigma,
        relative,
        relative_sigma,
        {name: float(d.between(lab_measured, lab_rendered)) for name, d in COLOUR_DIFFERENCES.items()},
        {name: figures.mean for name, figures in noise.items()},
        xyz_measured,
        xyz_rendered,
    )


@dataclass(frozen=True, eq=False)
class _Residuals:
    """Residuals, and what their chi-square is compared with."""

    #: (band, y, x) residuals; NaN for samples that are not used.
    values: NDArray[np.float64]
    #: (band, y, x) samples that are used.
    used: NDArray[np.bool_]
    #: Degrees of freedom of each sample, 1 less its share of the fitted parameters.
    freedom: float
    #: Relative standard deviation of the noise's variance, common to all residuals.
    variance_sigma: float

    def chi_square(self, where: NDArray[np.bool_]) -> ChiSquare:
        """Chi-square of the samples used in a mask that broadcasts to (band, y, x)."""
        values = self.values[np.broadcast_to(where, self.values.shape) & self.used]
        return ChiSquare(float(np.sum(values**2)), values.size, values.size * self.freedom, self.variance_sigma)


def _band(
    residuals: _Residuals,
    index: int,
    measured: NDArray,
    rendered: NDArray,
    variance: NDArray,
    on_surface: NDArray[np.bool_],
) -> BandRow:
    """Row of one band from (band, y, x) images, over the pixels of surfaces."""
    measured, rendered, variance = measured[index], rendered[index], variance[index]
    where = residuals.used[index] & on_surface
    unexplained = float(np.sum(((measured - rendered) ** 2 - variance)[where]))
    power = float(np.sum(rendered[where] ** 2))
    beyond_noise = float(np.sqrt(max(unexplained, 0.0) / power)) if power > 0 else float("nan")
    chi2 = residuals.chi_square(np.arange(len(residuals.used))[:, None, None] == index)
    return BandRow(chi2, _relative(measured, rendered, variance, where), beyond_noise)


def _check(
    images: xr.Dataset,
    other: xr.Dataset,
    shape: tuple[int, ...],
    used: NDArray[np.bool_],
    variance: NDArray[np.float64],
) -> None:
    if list(images.band.values) != list(other.band.values):
        raise ValueError(f"bands differ: {list(images.band.values)} and {list(other.band.values)}")
    for index, band in enumerate(images.band.values):
        values = (images.signal.values[index], other.signal.values[index], variance[index])
        finite = all(np.isfinite(v[used[index]]).all() for v in values)
        if not finite or (variance[index][used[index]] <= 0).any():
            raise ValueError(f"band {band}: an unmasked pixel with a signal that is not finite or has no variance")
    if images.signal.shape[1:] != shape:
        raise ValueError(f"surface image {shape} does not fit band images {images.signal.shape}")


def _sample_maps(
    photograph: NDArray[np.float64],
    model: NDArray[np.float64],
    variance: NDArray[np.float64],
    residual: NDArray[np.float64],
) -> dict[str, tuple]:
    """Signals and residuals as variables of a dataset."""
    return {
        "measured": (_SAMPLES, photograph, {"units": "DN"}),
        "rendered": (_SAMPLES, model, {"units": "DN"}),
        "sigma": (_SAMPLES, np.sqrt(variance), {"units": "DN"}),
        "residual_over_sigma": (_SAMPLES, residual, {"units": "1"}),
    }


def _masked_pixels(mask: NDArray) -> dict[str, int]:
    """Number of pixels that a (band, y, x) mask leaves out in any band, by reason."""
    return {
        reason.name.lower(): int(((mask & reason.value) > 0).any(axis=0).sum())
        for reason in Mask
        if reason.name and reason.is_defect
    }


def compare(
    measured: xr.Dataset,
    rendered: xr.Dataset,
    sensor_variance: ArrayLike,
    *,
    xyz_per_dn: ArrayLike,
    lamp_xyz: ArrayLike,
    surface: ArrayLike,
    surface_names: Sequence[str],
    single_surface: ArrayLike,
    expectation: Expectation = _EXACT,
    cell: tuple[int, int] | None = None,
) -> Comparison:
    """Compare two sets of band images of the same exposures, see ``band_images``.

    Behind a mosaic a pixel has one channel, so that quantities of all bands are those of a cell: XYZ by the means of
    the pixels that each band sees in it, the same for measured and rendered, with the variance of these means. All
    pixels of the cell get them, and their statistics count the cell once. A surface's means are those of all pixels
    that each band sees in its interior.

    The statistics of a band use the pixels not masked in that band; colours use those not masked in any band. Pixels
    with surface -1 (a black background) count only in chi2. All noise is taken as independent between pixels and bands.

    Parameters
    ----------
    measured
        Band images of the photograph: signal (DN) and mask, (band, y, x).
    rendered
        Band images of the rendering: signal (DN), Monte Carlo variance (DN^2) and mask; the lamp must be masked.
    sensor_variance
        (band, y, x) variance of the camera's noise, DN^2.
    xyz_per_dn
        (3, band) X, Y, Z per count, 683 b_i / K_i, the same for measured and rendered.
    lamp_xyz
        (3,) X, Y, Z of the lamp with the same weights, in any scale.
    surface
        (y, x) index of the surface, see ``regions``.
    surface_names
        Names of the surfaces.
    single_surface
        (y, x) False where a pixel sees several surfaces or faces.
    expectation
        Fitted parameters and common error of the noise, for the chi2 that noise gives.
    cell
        (height, width) of one repeat of the sensor's mosaic, px; None without a mosaic.

    Returns
    -------
    Comparison
        Statistics and maps.

    Raises
    ------
    ValueError
        If layouts differ or an unmasked value is not finite.
    """
    surface, single_surface = np.asarray(surface), np.asarray(single_surface, bool)
    weights = np.asarray(xyz_per_dn, float)
    photograph, model = measured.signal.values, rendered.signal.values
    sensor, noise = np.asarray(sensor_variance, float), rendered.variance.values
    mask = measured.mask.values | rendered.mask.values
    used = mask == 0
    variance = sensor + noise
    _check(measured, rendered, surface.shape, used, variance)
    bands = tuple(str(b) for b in measured.band.values)
    if weights.shape != (3, len(bands)):
        raise ValueError(f"xyz_per_dn has shape {weights.shape}, expected (3, {len(bands)})")

    with np.errstate(divide="ignore", invalid="ignore"):
        residual = np.where(used, (photograph - model) / np.sqrt(variance), np.nan)
        sigma_ratio = np.sqrt(noise / sensor)[used & (model > 0)]
    parameters_each = expectation.fitted_parameters / max(int(used.sum()), 1)
    residuals = _Residuals(residual, used, 1.0 - parameters_each, expectation.variance_sigma)
    distance = edge_distance_px(surface, single_surface)
    inner, on_surface = distance >= INTERIOR_DISTANCE_PX, surface >= 0
    chi2_edges, chi2_interiors = residuals.chi_square(~inner), residuals.chi_square(inner)
    excess = max(chi2_edges.excess, 0.0), max(chi2_interiors.excess, 0.0)
    images = photograph, model, variance
    colours = pixel_colours(images, used, on_surface, inner, weights, lamp_xyz, cell)
    by_surface = {
        name: _surface(
            residuals.chi_square(surface == i),
            (colours.coloured if cell is None else on_surface) & inner & (surface == i),
            photograph,
            model,
            variance,
            used=None if cell is None else used,
            xyz_per_dn=weights,
            white=colours.white,
        )
        for i, name in enumerate(surface_names)
    }
    variables = {
        **_sample_maps(photograph, model, variance, residual),
        "mask": (_SAMPLES, mask, measured.mask.attrs),
        **colours.variables,
        "surface": (_PIXELS, surface.astype(np.int16)),
        "edge_distance_px": (_PIXELS, distance, {"units": "px"}),
    }
    return Comparison(
        bands=bands,
        maps=xr.Dataset(
            variables,
            coords={"band": list(bands), "xyz": ["X", "Y", "Z"]},
            attrs={"surface_names": list(surface_names)},
        ),
        xyz_per_dn=weights,
        white=colours.white,
        chi2=residuals.chi_square(np.array(True)),
        chi2_edges=chi2_edges,
        chi2_interiors=chi2_interiors,
        share_of_excess_at_edges=excess[0] / sum(excess) if sum(excess) > 0 else float("nan"),
        by_band={band: _band(residuals, i, *images, on_surface) for i, band in enumerate(bands)},
        by_surface=by_surface,
        colour={name: statistics(values[colours.single]) for name, values in colours.maps.items()},
        colour_noise=colours.noise,
        luminance=_relative(
            colours.xyz_measured[..., 1], colours.xyz_rendered[..., 1], colours.luminance_variance, colours.single
        ),
        render_sigma_over_sensor_sigma=float(np.median(sigma_ratio)) if sigma_ratio.size else float("nan"),
        pixels_used=int((colours.complete if cell is None else used.any(axis=0)).sum()),
        masked=_masked_pixels(mask),
        cell=cell,
    )
