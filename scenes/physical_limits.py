"""Sizes that the numbers of a laboratory can have, and those that they usually have.

A number outside its possible range is a mistake in every laboratory. One outside its usual range is most often in
another unit. Both have generous margins: the ranges of real cameras stand in the reasons.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

__all__ = ["PHYSICAL_LIMITS", "Limits", "numbers_of", "within_limits"]


@dataclass(frozen=True)
class Limits:
    """Possible and usual sizes of a number."""

    #: Smallest and largest possible value.
    possible: tuple[float, float]
    #: Smallest and largest usual value.
    usual: tuple[float, float]
    #: Its unit; empty for a number without one.
    unit: str
    #: What real cameras and laboratories have.
    reason: str

    def is_usual(self, value: float) -> bool:
        """Whether a value is within the usual range.

        Parameters
        ----------
        value
            The number, in its unit.

        Returns
        -------
        bool
            True at the ends, too.
        """
        return self.usual[0] <= value <= self.usual[1]


def _usual(low: float, high: float, usual: tuple[float, float], unit: str, reason: str) -> Limits:
    return Limits((low, high), usual, unit, reason)


def _possible(low: float, high: float, unit: str, reason: str) -> Limits:
    return Limits((low, high), (low, high), unit, reason)


#: By key of a capture's manifest, the sizes of its number.
PHYSICAL_LIMITS: Mapping[str, Limits] = MappingProxyType(
    {
        "width_px": _possible(1, 2**20, "px", "the widest sensors have some 30,000 columns"),
        "height_px": _possible(1, 2**20, "px", "the highest sensors have some 30,000 rows"),
        "full_width_px": _possible(1, 2**20, "px", "the widest sensors have some 30,000 columns"),
        "full_height_px": _possible(1, 2**20, "px", "the highest sensors have some 30,000 rows"),
        "u0_px": _possible(0, 2**20, "px", "the widest sensors have some 30,000 columns"),
        "v0_px": _possible(0, 2**20, "px", "the highest sensors have some 30,000 rows"),
        "binning": _possible(1, 4096, "px", "sums of a few to some hundred pixels a side are in use"),
        "pixel_pitch_um": _usual(0.05, 2e4, (0.3, 5e3), "um", "pixels are 0.5 to 50 um wide, sums of many more"),
        "gain_e_per_dn": _usual(1e-4, 1e6, (1e-3, 1e4), "e-/DN", "sensors have 0.02 to 200 electrons a count"),
        "read_noise_e": _usual(0, 1e5, (0, 2000), "e-", "sensors have 0.3 to 100 electrons"),
        "readout_s": _usual(0, 1e5, (0, 600), "s", "cameras read a frame in 0.001 to 60 s"),
        "black_level_dn": _possible(0, 2**16 - 1, "DN", "counts of 16 bits end at 65535"),
        "white_level_dn": _possible(1, 2**16 - 1, "DN", "counts of 16 bits end at 65535"),
        "focal_length_mm": _usual(0.1, 1e5, (1, 3000), "mm", "lenses have 1 to 2000 mm"),
        "fx_px": _usual(1, 1e7, (5, 1e6), "px", "lenses have some hundred to 100,000 px"),
        "fy_px": _usual(1, 1e7, (5, 1e6), "px", "lenses have some hundred to 100,000 px"),
        "f_number": _usual(0.1, 5000, (0.5, 64), "", "lenses have 0.7 to 45"),
        "image_distance_mm": _usual(0.1, 1e6, (0.5, 2e4), "mm", "it is one to a few focal lengths"),
        "exposure_s": _usual(1e-9, 1e6, (1e-6, 1e5), "s", "cameras expose for 1e-5 s to some hours"),
        "start_s": _usual(-1e10, 1e10, (-1e10, 1e10), "s", "seconds since 1970 are 2e9"),
        "relative_uncertainty": _usual(0, 100, (0, 100), "", "it is a fraction, such as 0.02"),
        "spectral_uncertainty": _usual(0, 100, (0, 100), "", "it is a fraction, such as 0.01"),
        "point_sigma_px": _usual(1e-6, 1e3, (1e-3, 30), "px", "marks are off by 0.02 to 3 px"),
        "rows": _possible(1, 1000, "", "boards have 3 to 50 rows"),
        "columns": _possible(1, 1000, "", "boards have 3 to 50 columns"),
        "pitch_mm": _usual(1e-2, 1e4, (0.1, 1000), "mm", "boards have squares of 1 to 200 mm"),
        "origin_mm": _usual(-1e6, 1e6, (-1e5, 1e5), "mm", "boxes are below 10 m wide"),
        "distortion": _possible(-1e4, 1e4, "", "coefficients of lenses are below 10"),
        "window_px": _possible(0, 2**20, "px", "the widest sensors have some 30,000 columns"),
        "gain_e_per_unit": _possible(1e-12, 1e15, "e-", "the unit of merged pictures is theirs"),
    }
)


def within_limits(key: str, value: Any) -> Any:
    """A value of a manifest itself, where its numbers are possible.

    Parameters
    ----------
    key
        Its key; those without limits are not checked.
    value
        A number, several of them, or a table of them.

    Returns
    -------
    Any
        The value itself.

    Raises
    ------
    ValueError
        With the possible range, if a number is outside.
    """
    limits = PHYSICAL_LIMITS.get(key)
    if limits is None:
        return value
    low, high = limits.possible
    if not all(low <= number <= high for number in numbers_of(value)):
        unit = f" {limits.unit}" if limits.unit else ""
        raise ValueError(f"{low:g} to {high:g}{unit}: {limits.reason}")
    return value


def numbers_of(value: Any) -> list[float]:
    """Numbers in a value of a manifest.

    Parameters
    ----------
    value
        A number, several of them, a table of them, or anything else.

    Returns
    -------
    list of float
        Empty for anything else.
    """
    if isinstance(value, Mapping):
        value = tuple(value.values())
    if isinstance(value, tuple):
        return [number for each in value for number in numbers_of(each)]
    return [float(value)] if isinstance(value, int | float) and not isinstance(value, bool) else []
