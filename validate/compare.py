"""Measured against rendered: the residual judged by its noise, and colour differences, as maps and tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from cboxlab.calibration.band_images import Mask
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2 as chi2_distribution

from .colour_difference import (
    DifferenceStatistics,
    White,
    delta_e_2000,
    delta_e_ab,
    expected_from_noise,
    lab,
    statistics,
    white_of,
)  # fmt: skip
from .regions import INTERIOR_DISTANCE_PX, edge_distance_px

__all__ = ["BandRow", "ChiSquare", "Comparison", "RelativeDifference", "SurfaceRow", "compare"]


@dataclass(frozen=True)
class ChiSquare:
    """Sum of squared residuals over sigma, and what noise alone allows.

    value : the sum. count : residuals in it. dof : count less their share of the fitted parameters.
    """

    value: float
    count: int
    dof: float

    @property
    def per_dof(self) -> float:
        """1 where noise explains everything; NaN without pixels."""
        return self.value / self.dof if self.dof > 0 else float("nan")

    @property
    def per_dof_sigma(self) -> float:
        """Standard deviation of ``per_dof`` under pure Gaussian noise, sqrt(2 / dof)."""
        return float(np.sqrt(2.0 / self.dof)) if self.dof > 0 else float("nan")

    @property
    def p_value(self) -> float:
        """Probability of a value at least as large from noise alone."""
        return float(chi2_distribution.sf(self.value, self.dof)) if self.dof > 0 else float("nan")

    @property
    def excess(self) -> float:
        """What stands above the expectation; negative where there is less than noise predicts."""
        return self.value - self.dof


@dataclass(frozen=True)
class RelativeDifference:
    """Of (measured - rendered) / rendered over pixels: mean, rms, and the rms that noise alone gives."""

    mean: float
    rms: float
    rms_noise: float


@dataclass(frozen=True)
class BandRow:
    """One band. beyond_noise : rms of what noise does not explain, relative to the rms rendered signal."""

    chi2: ChiSquare
    relative: RelativeDifference
    beyond_noise: float


@dataclass(frozen=True, eq=False)
class SurfaceRow:
    """One surface. chi2 covers all its pixels, everything else is a mean over its interior.

    measured, rendered, sigma : (band,) interior means in DN and the standard error of their difference.
    relative, relative_sigma : (band,) (measured - rendered) / rendered and its standard error.
    delta_e_noise : mean Delta E*ab that noise alone gives between these means. All NaN without interior.
    """

    chi2: ChiSquare
    interior_pixels: int
    measured: NDArray[np.float64]
    rendered: NDArray[np.float64]
    sigma: NDArray[np.float64]
    relative: NDArray[np.float64]
    relative_sigma: NDArray[np.float64]
    delta_e_ab: float
    delta_e_2000: float
    delta_e_noise: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """The outcome of one comparison; immutable.

    maps : Dataset of (band, y, x) measured, rendered, sigma (DN), residual_over_sigma, mask; (y, x, xyz)
        xyz_measured, xyz_rendered; (y, x) delta_e_ab, delta_e_2000, luminance_relative_difference, surface,
        edge_distance_px. NaN where a pixel was left out,
        but signals and XYZ stand as they are.
    share_of_excess_at_edges : 0 to 1, of the chi2 above expectation; NaN where there is none.
    masked : pixels left out in at least one band, by reason; a pixel may have several.
    """

    bands: tuple[str, ...]
    maps: xr.Dataset
    white: White
    chi2: ChiSquare
    chi2_edges: ChiSquare
    chi2_interiors: ChiSquare
    share_of_excess_at_edges: float
    by_band: dict[str, BandRow]
    by_surface: dict[str, SurfaceRow]
    delta_e_ab: DifferenceStatistics
    delta_e_2000: DifferenceStatistics
    delta_e_ab_noise: DifferenceStatistics
    delta_e_2000_noise: DifferenceStatistics
    luminance: RelativeDifference
    render_sigma_over_sensor_sigma: float
    pixels_used: int
    masked: dict[str, int]


def _relative(
    measured: NDArray[np.float64], rendered: NDArray[np.float64], variance: NDArray[np.float64],
    where: NDArray[np.bool_],
) -> RelativeDifference:  # fmt: skip
    r = rendered[where & (rendered > 0)]
    if r.size == 0:
        return RelativeDifference(np.nan, np.nan, np.nan)
    ratio = measured[where & (rendered > 0)] / r - 1.0
    noise = variance[where & (rendered > 0)] / r**2
    return RelativeDifference(
        float(ratio.mean()), float(np.sqrt(np.mean(ratio**2))), float(np.sqrt(noise.mean()))
    )


def _surface(
    chi2: ChiSquare, inside: NDArray[np.bool_], measured: NDArray[np.float64], rendered: NDArray[np.float64],
    variance: NDArray[np.float64], xyz_per_dn: NDArray[np.float64], white: White, seed: int,
) -> SurfaceRow:  # fmt: skip
    n = int(inside.sum())
    if n == 0:
        nothing = np.full(measured.shape[0], np.nan)
        return SurfaceRow(chi2, 0, nothing, nothing, nothing, nothing, nothing, np.nan, np.nan, np.nan)
    mean_measured, mean_rendered = measured[:, inside].mean(axis=1), rendered[:, inside].mean(axis=1)
    sigma = np.sqrt(variance[:, inside].sum(axis=1)) / n
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(mean_rendered > 0, mean_measured / mean_rendered - 1.0, np.nan)
        relative_sigma = np.where(mean_rendered > 0, sigma / mean_rendered, np.nan)
    seen, expected = lab(xyz_per_dn @ mean_measured, white), lab(xyz_per_dn @ mean_rendered, white)
    noise, _ = expected_from_noise(mean_rendered[:, None], sigma[:, None], xyz_per_dn, white, seed)
    return SurfaceRow(
        chi2, n, mean_measured, mean_rendered, sigma, relative, relative_sigma,
        float(delta_e_ab(seen, expected)), float(delta_e_2000(seen, expected)), noise.mean,
    )  # fmt: skip


def _check(images: xr.Dataset, other: xr.Dataset, shape: tuple[int, ...], used: NDArray[np.bool_],
           variance: NDArray[np.float64]) -> None:  # fmt: skip
    if list(images.band.values) != list(other.band.values):
        raise ValueError(f"bands differ: {list(images.band.values)} and {list(other.band.values)}")
    for index, band in enumerate(images.band.values):
        values = (images.signal.values[index], other.signal.values[index], variance[index])
        finite = all(np.isfinite(v[used[index]]).all() for v in values)
        if not finite or (variance[index][used[index]] <= 0).any():
            raise ValueError(f"band {band}: an unmasked pixel whose signal is not finite or has no variance")
    if images.signal.shape[1:] != shape:
        raise ValueError(f"surface image {shape} does not fit band images {images.signal.shape}")


def compare(
    measured: xr.Dataset,
    rendered: xr.Dataset,
    sensor_variance: ArrayLike,
    *,
    xyz_per_dn: ArrayLike,
    lamp_xyz: ArrayLike,
    surface: ArrayLike,
    surface_names: Sequence[str],
    pure: ArrayLike,
    fitted_parameters: int = 0,
    seed: int = 0,
) -> Comparison:
    """Compare two sets of band images (see ``band_images``) of the same exposures.

    sensor_variance : (band, y, x) DN^2 of the camera's noise; the Monte Carlo variance of the render is
        ``rendered.variance``. Both are taken as independent between pixels and bands.
    xyz_per_dn : (3, band) X, Y, Z per count, 683 b_i / K_i; measured and rendered go through the same.
    lamp_xyz : (3,) of the lamp through the same weights, any scale. surface, pure : see ``regions``; the lamp
        itself has to be masked. fitted_parameters : taken off the degrees of freedom.

    A band's figures use the pixels not masked in that band; colours use those masked in no band. Pixels with
    surface -1 (a black background) count in chi2 and nowhere else. Raises ValueError where layouts differ or
    an unmasked value is not finite.
    """
    surface, pure = np.asarray(surface), np.asarray(pure, bool)
    weights = np.asarray(xyz_per_dn, float)
    seen, model = measured.signal.values, rendered.signal.values
    sensor, noise = np.asarray(sensor_variance, float), rendered.variance.values
    mask = measured.mask.values | rendered.mask.values
    used = mask == 0
    variance = sensor + noise
    _check(measured, rendered, surface.shape, used, variance)
    bands = tuple(str(b) for b in measured.band.values)
    if weights.shape != (3, len(bands)):
        raise ValueError(f"xyz_per_dn has shape {weights.shape}, expected (3, {len(bands)})")

    with np.errstate(divide="ignore", invalid="ignore"):
        residual = np.where(used, (seen - model) / np.sqrt(variance), np.nan)
        sigma_ratio = np.sqrt(noise / sensor)[used]
    parameters_each = fitted_parameters / max(int(used.sum()), 1)

    def chi_square(where: NDArray[np.bool_]) -> ChiSquare:
        values = residual[np.broadcast_to(where, residual.shape) & used]
        return ChiSquare(float(np.sum(values**2)), values.size, values.size * (1.0 - parameters_each))

    distance = edge_distance_px(surface, pure)
    inner = distance >= INTERIOR_DISTANCE_PX
    chi2_edges, chi2_interiors = chi_square(~inner), chi_square(inner)
    excess = max(chi2_edges.excess, 0.0), max(chi2_interiors.excess, 0.0)

    whole = used.all(axis=0)
    on_surface = surface >= 0
    coloured = whole & on_surface
    xyz_seen = np.einsum("cb,byx->yxc", weights, seen)
    xyz_model = np.einsum("cb,byx->yxc", weights, model)
    white = white_of(lamp_xyz, xyz_model[on_surface, 1])
    lab_seen, lab_model = lab(xyz_seen, white), lab(xyz_model, white)
    blank = np.where(coloured, 0.0, np.nan)
    e_ab, e_2000 = (blank + f(lab_seen, lab_model) for f in (delta_e_ab, delta_e_2000))
    e_ab_noise, e_2000_noise = expected_from_noise(
        model[:, coloured], np.sqrt(variance[:, coloured]), weights, white, seed
    )
    luminance_variance = np.einsum("b,byx->yx", weights[1] ** 2, variance)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = xyz_seen[..., 1] / xyz_model[..., 1]
        luminance_map = blank + np.where(xyz_model[..., 1] > 0, ratio - 1.0, np.nan)

    by_band = {}
    for i, band in enumerate(bands):
        where = used[i] & on_surface
        unexplained = float(np.sum(((seen[i] - model[i]) ** 2 - variance[i])[where]))
        power = float(np.sum(model[i][where] ** 2))
        by_band[band] = BandRow(
            chi_square(np.arange(len(bands))[:, None, None] == i),
            _relative(seen[i], model[i], variance[i], where),
            float(np.sqrt(max(unexplained, 0.0) / power)) if power > 0 else float("nan"),
        )
    by_surface = {
        name: _surface(chi_square(surface == i), coloured & inner & (surface == i), seen, model, variance,
                       weights, white, seed)
        for i, name in enumerate(surface_names)
    }  # fmt: skip

    image, stack = ("y", "x"), ("band", "y", "x")
    maps = xr.Dataset(
        {
            "measured": (stack, seen, {"units": "DN"}),
            "rendered": (stack, model, {"units": "DN"}),
            "sigma": (stack, np.sqrt(variance), {"units": "DN"}),
            "residual_over_sigma": (stack, residual, {"units": "1"}),
            "mask": (stack, mask, measured.mask.attrs),
            "xyz_measured": ((*image, "xyz"), xyz_seen),
            "xyz_rendered": ((*image, "xyz"), xyz_model),
            "delta_e_ab": (image, e_ab, {"units": "1"}),
            "delta_e_2000": (image, e_2000, {"units": "1"}),
            "luminance_relative_difference": (image, luminance_map, {"units": "1"}),
            "surface": (image, surface.astype(np.int16)),
            "edge_distance_px": (image, distance, {"units": "px"}),
        },
        coords={"band": list(bands), "xyz": ["X", "Y", "Z"]},
        attrs={"surface_names": list(surface_names)},
    )
    return Comparison(
        bands=bands, maps=maps, white=white,
        chi2=chi_square(np.array(True)), chi2_edges=chi2_edges, chi2_interiors=chi2_interiors,
        share_of_excess_at_edges=excess[0] / sum(excess) if sum(excess) > 0 else float("nan"),
        by_band=by_band, by_surface=by_surface,
        delta_e_ab=statistics(e_ab), delta_e_2000=statistics(e_2000),
        delta_e_ab_noise=e_ab_noise, delta_e_2000_noise=e_2000_noise,
        luminance=_relative(xyz_seen[..., 1], xyz_model[..., 1], luminance_variance, coloured),
        render_sigma_over_sensor_sigma=float(np.median(sigma_ratio)) if sigma_ratio.size else float("nan"),
        pixels_used=int(whole.sum()),
        masked={reason.name.lower(): int(((mask & reason.value) > 0).any(axis=0).sum())
                for reason in Mask if reason.name},
    )  # fmt: skip
