"""Table of the luminances, chromaticities and illuminances of a rendered box."""

from __future__ import annotations

import math

from cboxlab.rendering.photometry import Photometry
from cboxlab.utils.table import Table

__all__ = ["photometry_table"]


def photometry_table(photometry: Photometry) -> Table:
    """Photometry of each surface, of the lamp and of the entire picture.

    Parameters
    ----------
    photometry
        Photometry of a rendered box.

    Returns
    -------
    Table
        Luminance with its standard error (cd/m²), x, y, the larger standard error of both, number of pixels, and
        illuminance (lx). A dash stands for a value that is not known.
    """
    parts = [(name, part, photometry.illuminance(name)) for name, part in photometry.surfaces.items()]
    parts += [("lamp", photometry.lamp, math.nan), ("whole picture", photometry.picture, math.nan)]
    rows = tuple(
        (
            name,
            _with_error(part.luminance, part.luminance_sigma),
            *(_number(value, ".4f") for value in part.chromaticity),
            _number(float(part.chromaticity_sigma.max()), ".5f"),
            str(part.pixels),
            _number(illuminance_lx, ".4g"),
        )
        for name, part, illuminance_lx in parts
    )
    title = "Luminance (CIE 1931), over pixels that a surface covers entirely"
    return Table(title, ("surface", "cd/m²", "x", "y", "± x, y", "px", "lx"), rows)


def _with_error(value: float, sigma: float) -> str:
    """A value and its standard error with two digits; a dash for NaN."""
    if not (math.isfinite(sigma) and sigma > 0):
        return _number(value, ".5g")
    digits = max(1 - math.floor(math.log10(sigma)), 0)
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def _number(value: float, form: str) -> str:
    """The formatted value, without an exponent if it is large; a dash for NaN."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:{form}}"
    return f"{float(text):.0f}" if "e+" in text else text
