"""Numbers as text."""

from __future__ import annotations

import numpy as np

__all__ = ["MINUS", "chi2_text", "number", "percent", "significant", "to_error", "with_error"]

#: Decimal places of a reduced chi-square below 10: its standard deviation is some thousandths.
_CHI2_PLACES = 3

#: Most decimal places of a number; smaller numbers are written with an exponent.
_MAX_PLACES = 6

#: Most decimal places of a value that is rounded to its standard deviation.
_MAX_PLACES_OF_VALUE = 9

#: Translation of the hyphen to a minus sign.
MINUS = str.maketrans("-", "−")


def number(value: float, digits: int = 2, sign: bool = False) -> str:
    """Number as text with a fixed number of decimal places.

    Parameters
    ----------
    value
        The number.
    digits
        Decimal places.
    sign
        Whether a positive number has a plus sign.

    Returns
    -------
    str
        Text with a minus sign, zero without sign; a dash for NaN.
    """
    if not np.isfinite(value):
        return "–"
    rounded = round(value, digits) + 0.0  # adding 0.0 turns -0.0 into 0.0
    return f"{rounded:{'+' if sign and rounded else ''}.{digits}f}".translate(MINUS)


def percent(share: float, digits: int = 1) -> str:
    """Share in percent as text, without the percent sign.

    Parameters
    ----------
    share
        The share, 1 for all.
    digits
        Decimal places.

    Returns
    -------
    str
        Text; a dash for NaN.
    """
    return number(100 * share, digits)


def significant(value: float, digits: int = 3) -> str:
    """Measured number as text with significant digits, zeros at its end included.

    Parameters
    ----------
    value
        The number.
    digits
        Significant digits.

    Returns
    -------
    str
        Text with a minus sign; a dash for NaN.
    """
    if not np.isfinite(value):
        return "–"
    return f"{value:#.{digits}g}".removesuffix(".").translate(MINUS) if value else "0"


def chi2_text(value: float) -> str:
    """Reduced chi-square as text, with the same digits wherever a page states it.

    Parameters
    ----------
    value
        Chi-square per degree of freedom.

    Returns
    -------
    str
        Text with three decimal places below 10, and fewer above; a dash for NaN.
    """
    whole_digits = int(np.floor(np.log10(value))) if np.isfinite(value) and value > 1 else 0
    return number(value, max(_CHI2_PLACES - whole_digits, 0))


def to_error(value: float, sigma: float) -> str:
    """Value rounded to two significant digits of its standard deviation.

    Parameters
    ----------
    value
        The value.
    sigma
        Its standard deviation; NaN or 0 if not known.

    Returns
    -------
    str
        Text; seven significant digits without a standard deviation.
    """
    decimals = _decimals(sigma)
    return _plain(value, 7) if decimals is None else number(value, min(decimals, _MAX_PLACES_OF_VALUE))


def with_error(value: float, sigma: float) -> str:
    """Value ± standard deviation, to two significant digits of the latter.

    Parameters
    ----------
    value
        The value.
    sigma
        Its standard deviation; NaN or 0 if not known.

    Returns
    -------
    str
        Text; four significant digits of the value without a standard deviation.
    """
    decimals = _decimals(sigma)
    if decimals is None:
        return _plain(value, 4)
    if decimals > _MAX_PLACES:
        digits = int(np.floor(np.log10(max(abs(value), sigma)))) + decimals + 1
        return f"{significant(value, digits)} ± {significant(sigma, 2)}"
    return f"{number(value, decimals)} ± {number(sigma, decimals)}"


def _plain(value: float, digits: int) -> str:
    """Number as text with up to some significant digits, without zeros at its end."""
    return f"{value:.{digits}g}".translate(MINUS) if np.isfinite(value) else "–"


def _decimals(sigma: float) -> int | None:
    """Decimal places for two significant digits of a standard deviation; None without one."""
    return max(int(1 - np.floor(np.log10(sigma))), 0) if np.isfinite(sigma) and sigma > 0 else None
