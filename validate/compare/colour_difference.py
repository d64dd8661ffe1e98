"""Colour differences between photograph and rendering, and their expectation from noise.

CIELab follows CIE 15:2018 section 8.2.1. `COLOUR_DIFFERENCES` is the one table of differences: maps, metrics, tables of
the report, the viewer and the terminal take identifier, label, unit and formula from it. The formulas are those of
colour-science: Delta E*ab of 1976, and CIEDE2000 (Luo, Cui and Rigg 2001; Sharma, Wu and Dalal 2005).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "COLOUR_DIFFERENCES",
    "HEADLINE",
    "NOISE_SEED",
    "ColourDifference",
    "DifferenceStatistics",
    "White",
    "expected_from_noise",
    "lab",
    "srgb_matrix",
    "srgb_preview",
    "statistics",
    "white_of",
]

#: Percentile of the rendered luminance outside the lamp that is used as white (Yn): close to the largest value, but
#: not decided by single pixels.
WHITE_PERCENTILE = 99.5

#: Seed of the noise from which colour differences are expected: any, but the same in every comparison.
NOISE_SEED = 0

#: Number of colour differences drawn for the expectation from noise: enough for 0.3% on a mean.
DRAWS = 1 << 16

#: Most pictures drawn for it: a surface's mean is one pixel, and would be drawn 65,536 times.
MAX_PICTURES = 256


@dataclass(frozen=True)
class White:
    """The white of CIELab."""

    #: Chromaticity coordinate x of CIE 1931.
    x: float
    #: Chromaticity coordinate y of CIE 1931.
    y: float
    #: Luminance in the unit of the XYZ values.
    luminance: float


@dataclass(frozen=True)
class DifferenceStatistics:
    """Statistics of a map of differences; NaN without pixels."""

    #: Mean over the pixels.
    mean: float
    #: 95th percentile over the pixels.
    p95: float
    #: Largest value.
    maximum: float


def _delta_e_ab(lab_1: ArrayLike, lab_2: ArrayLike) -> NDArray[np.float64]:
    """Delta E*ab of 1976 (...,) between CIELab values (..., 3)."""
    from colour.difference import delta_E_CIE1976  # slow to import, and only needed here

    return np.asarray(delta_E_CIE1976(np.asarray(lab_1), np.asarray(lab_2)))


def _delta_e_2000(lab_1: ArrayLike, lab_2: ArrayLike) -> NDArray[np.float64]:
    """CIEDE2000 (...,) between CIELab values (..., 3), kL = kC = kH = 1."""
    from colour.difference import delta_E_CIE2000

    return np.asarray(delta_E_CIE2000(np.asarray(lab_1), np.asarray(lab_2)))


@dataclass(frozen=True)
class ColourDifference:
    """One measure of the difference of two colours."""

    #: Identifier: key in metrics.json, name of the map, name of the viewer's layer.
    id: str
    #: Short name in tables and sentences.
    label: str
    #: Name of its maps, with the year where the label does not say it.
    title: str
    #: Name of its channel in difference.exr.
    channel: str
    #: Formula for CIELab values (..., 3) and (..., 3); returns (...,).
    between: Callable[[ArrayLike, ArrayLike], NDArray[np.float64]]
    #: Name of the same formula in viewer/static/colour.js; None where the viewer does not compute it.
    script: str | None = None
    #: Unit; "1" for a number without one.
    unit: str = "1"


#: The differences by identifier, in the order in which tables, maps and lists show them. Headline figures, verdict and
#: the table of surfaces compare the first one with noise.
COLOUR_DIFFERENCES = {
    difference.id: difference
    for difference in (
        ColourDifference("delta_e_ab", "ΔE*ab", "ΔE*ab (1976)", "dE76", _delta_e_ab, "deltaE1976"),
        ColourDifference("delta_e_2000", "CIEDE2000", "CIEDE2000", "dE2000", _delta_e_2000, "deltaE2000"),
    )
}

#: The difference that stands for colour where there is room for one number.
HEADLINE = COLOUR_DIFFERENCES["delta_e_ab"]


def white_of(lamp_xyz: ArrayLike, rendered_luminance: ArrayLike) -> White:
    """White of the lamp's chromaticity and the 99.5th percentile of the rendered luminance.

    Parameters
    ----------
    lamp_xyz
        (3,) X, Y, Z of the lamp, in any scale.
    rendered_luminance
        Rendered Y of pixels outside the lamp, any shape.

    Returns
    -------
    White
        The white, its luminance in the unit of the rendered luminance.

    Raises
    ------
    ValueError
        If the lamp or the picture is black.
    """
    lamp = np.asarray(lamp_xyz, float)
    luminance = float(np.percentile(np.asarray(rendered_luminance, float), WHITE_PERCENTILE))
    if not (lamp.sum() > 0 and lamp[1] > 0 and luminance > 0):
        raise ValueError(f"no white: lamp XYZ {lamp}, 99.5th percentile of rendered Y {luminance:g}")
    return White(float(lamp[0] / lamp.sum()), float(lamp[1] / lamp.sum()), luminance)


def lab(xyz: ArrayLike, white: White) -> NDArray[np.float64]:
    """CIELab of XYZ; L* is 100 at the white.

    Parameters
    ----------
    xyz
        (..., 3) X, Y, Z in the unit of the white's luminance.
    white
        The white.

    Returns
    -------
    NDArray
        (..., 3) L*, a*, b*.
    """
    from colour import XYZ_to_Lab

    relative = np.asarray(xyz, float) / white.luminance
    return np.asarray(XYZ_to_Lab(relative, np.array([white.x, white.y])), np.float64)


def statistics(values: ArrayLike) -> DifferenceStatistics:
    """Mean, 95th percentile and maximum over the finite values.

    Parameters
    ----------
    values
        Differences of any shape; NaN where a pixel is left out.

    Returns
    -------
    DifferenceStatistics
        The statistics, NaN without a finite value.
    """
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
) -> dict[str, DifferenceStatistics]:
    """Colour differences expected from noise alone, if the rendering is exact.

    Gaussian noise, independent between bands, is drawn for every pixel and goes through the same formulas. Each
    statistic is averaged over repeated pictures.

    Parameters
    ----------
    signal
        (band, n) rendered signal, DN.
    sigma
        (band, n) standard deviation of measured minus rendered, DN.
    xyz_per_dn
        (3, band) X, Y, Z per count.
    white
        The white of CIELab.
    seed
        Seed of the noise.

    Returns
    -------
    dict
        Statistics by identifier of the difference; NaN without pixels.
    """
    n = signal.shape[1]
    if n == 0:
        return {name: statistics([]) for name in COLOUR_DIFFERENCES}
    pictures = int(np.clip(DRAWS // n, 1, MAX_PICTURES))
    generator = np.random.default_rng(seed)
    noisy = signal + sigma * generator.standard_normal((pictures, *signal.shape))
    truth = lab((xyz_per_dn @ signal).T, white)
    measured = lab(np.einsum("cb,pbn->pnc", xyz_per_dn, noisy), white)
    repeated = np.broadcast_to(truth, measured.shape)
    return {name: _averaged(difference.between(measured, repeated)) for name, difference in COLOUR_DIFFERENCES.items()}


def _averaged(differences: NDArray[np.float64]) -> DifferenceStatistics:
    """Mean of each statistic over (picture, n) differences; pixels with NaN are left out."""
    finite = np.compress(np.isfinite(differences).all(axis=0), differences, axis=1)
    if finite.size == 0:
        return statistics([])
    by_picture = finite.mean(axis=1), np.percentile(finite, 95, axis=1), finite.max(axis=1)
    return DifferenceStatistics(*(float(np.mean(values)) for values in by_picture))


def srgb_matrix(white: White) -> NDArray[np.float64]:
    """Matrix from XYZ to linear sRGB, adapted from the lamp's white to D65 (CAT02).

    Parameters
    ----------
    white
        The lamp's white.

    Returns
    -------
    NDArray
        (3, 3), for X, Y, Z relative to the white's luminance.
    """
    from colour import XYZ_to_sRGB

    columns = XYZ_to_sRGB(
        np.eye(3),
        np.array([white.x, white.y]),
        chromatic_adaptation_transform="CAT02",
        apply_cctf_encoding=False,
    )
    return np.asarray(columns, np.float64).T


def srgb_preview(xyz: ArrayLike, white: White) -> NDArray[np.uint8]:
    """8-bit sRGB picture of XYZ, adapted from the lamp's white to D65 (CAT02).

    Parameters
    ----------
    xyz
        (y, x, 3) X, Y, Z in the unit of the white's luminance; NaN where not known.
    white
        The lamp's white; it becomes 255.

    Returns
    -------
    NDArray
        (y, x, 3) sRGB, 0 to 255; mid grey for pixels with NaN.
    """
    from colour import XYZ_to_sRGB

    xyz = np.asarray(xyz, float) / white.luminance
    finite = np.isfinite(xyz).all(axis=-1, keepdims=True)
    rgb = XYZ_to_sRGB(np.where(finite, xyz, 0.0), np.array([white.x, white.y]), chromatic_adaptation_transform="CAT02")
    rgb = np.where(finite, np.clip(rgb, 0.0, 1.0), 0.5)
    return np.round(255 * rgb).astype(np.uint8)
