"""Colour differences between a measured and a rendered picture, and their expectation from noise alone.

CIELab after CIE 15:2018 section 8.2.1, Delta E*ab of 1976 and CIEDE2000 (Luo, Cui and Rigg 2001; Sharma, Wu
and Dalal 2005), computed with colour-science.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "DifferenceStatistics",
    "White",
    "delta_e_2000",
    "delta_e_ab",
    "expected_from_noise",
    "lab",
    "srgb_matrix",
    "srgb_preview",
    "statistics",
    "white_of",
]

#: Percentile of the rendered luminance outside the lamp that is used as white (Yn).
WHITE_PERCENTILE = 99.5

#: Number of colour differences drawn for the expectation from noise; enough for 0.3% on a mean.
DRAWS = 1 << 16


@dataclass(frozen=True)
class White:
    """The white of CIELab: chromaticity (x, y), and luminance in the unit of the XYZ values."""

    x: float
    y: float
    luminance: float


@dataclass(frozen=True)
class DifferenceStatistics:
    """Mean, 95th percentile and maximum of a map; NaN without pixels."""

    mean: float
    p95: float
    maximum: float


def white_of(lamp_xyz: ArrayLike, rendered_luminance: ArrayLike) -> White:
    """The lamp's chromaticity, and the 99.5th percentile of the rendered luminance (values outside the lamp).

    Raises ValueError if the lamp or the picture is black.
    """
    lamp = np.asarray(lamp_xyz, float)
    luminance = float(np.percentile(np.asarray(rendered_luminance, float), WHITE_PERCENTILE))
    if not (lamp.sum() > 0 and lamp[1] > 0 and luminance > 0):
        raise ValueError(f"no white: lamp XYZ {lamp}, 99.5th percentile of rendered Y {luminance:g}")
    return White(float(lamp[0] / lamp.sum()), float(lamp[1] / lamp.sum()), luminance)


def lab(xyz: ArrayLike, white: White) -> NDArray[np.float64]:
    """CIELab (..., 3) of XYZ (..., 3); L* is 100 at the white."""
    from colour import XYZ_to_Lab  # slow to import, and only needed here

    relative = np.asarray(xyz, float) / white.luminance
    return np.asarray(XYZ_to_Lab(relative, np.array([white.x, white.y])), np.float64)


def delta_e_ab(lab_1: ArrayLike, lab_2: ArrayLike) -> NDArray[np.float64]:
    """Delta E*ab of 1976 (...,) between CIELab values (..., 3)."""
    from colour.difference import delta_E_CIE1976

    return np.asarray(delta_E_CIE1976(np.asarray(lab_1), np.asarray(lab_2)))


def delta_e_2000(lab_1: ArrayLike, lab_2: ArrayLike) -> NDArray[np.float64]:
    """CIEDE2000 (...,) between CIELab values (..., 3), kL = kC = kH = 1."""
    from colour.difference import delta_E_CIE2000

    return np.asarray(delta_E_CIE2000(np.asarray(lab_1), np.asarray(lab_2)))


def statistics(values: ArrayLike) -> DifferenceStatistics:
    """Mean, p95 and maximum over the finite values."""
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    if finite.size == 0:
        return DifferenceStatistics(np.nan, np.nan, np.nan)
    return DifferenceStatistics(float(finite.mean()), float(np.percentile(finite, 95)), float(finite.max()))


def expected_from_noise(
    signal: NDArray[np.float64],
    sigma: NDArray[np.float64],
    xyz_per_dn: NDArray[np.float64],
    white: White,
    seed: int,
) -> tuple[DifferenceStatistics, DifferenceStatistics]:
    """Delta E*ab and CIEDE2000 expected from noise alone, if the render is exact.

    signal, sigma : (band, n), the rendered signal and the standard deviation of measured minus rendered, DN.
    xyz_per_dn : (3, band). Gaussian noise, independent between bands, is drawn for every pixel and processed by the
    same formulas; each statistic is averaged over repeated pictures.
    """
    n = signal.shape[1]
    if n == 0:
        return statistics([]), statistics([])
    pictures = int(np.clip(DRAWS // n, 1, 256))
    generator = np.random.default_rng(seed)
    noisy = signal + sigma * generator.standard_normal((pictures, *signal.shape))
    truth = lab((xyz_per_dn @ signal).T, white)
    seen = lab(np.einsum("cb,pbn->pnc", xyz_per_dn, noisy), white)
    repeated = np.broadcast_to(truth, seen.shape)
    first, second = (
        [statistics(picture) for picture in difference(seen, repeated)] for difference in (delta_e_ab, delta_e_2000)
    )
    return _average(first), _average(second)


def _average(figures: list[DifferenceStatistics]) -> DifferenceStatistics:
    return DifferenceStatistics(
        *(float(np.mean([getattr(f, name) for f in figures])) for name in ("mean", "p95", "maximum"))
    )


def srgb_matrix(white: White) -> NDArray[np.float64]:
    """(3, 3) from XYZ, relative to the white's luminance, to linear sRGB, adapted from the lamp to D65 (CAT02)."""
    from colour import XYZ_to_sRGB

    columns = XYZ_to_sRGB(
        np.eye(3),
        np.array([white.x, white.y]),
        chromatic_adaptation_transform="CAT02",
        apply_cctf_encoding=False,
    )
    return np.asarray(columns, np.float64).T


def srgb_preview(xyz: ArrayLike, white: White) -> NDArray[np.uint8]:
    """8-bit sRGB (y, x, 3) of XYZ (y, x, 3), adapted from the lamp's white to D65 (CAT02); the white is 255.

    Pixels with NaN are mid grey.
    """
    from colour import XYZ_to_sRGB

    xyz = np.asarray(xyz, float) / white.luminance
    known = np.isfinite(xyz).all(axis=-1, keepdims=True)
    rgb = XYZ_to_sRGB(np.where(known, xyz, 0.0), np.array([white.x, white.y]), chromatic_adaptation_transform="CAT02")
    rgb = np.where(known, np.clip(rgb, 0.0, 1.0), 0.5)
    return np.round(255 * rgb).astype(np.uint8)
