"""FLIP of photograph and rendering, by the evaluator of its authors, which is an extra.

FLIP (Andersson et al. 2020) is the difference that a person sees who flips between two pictures on a screen, 0 to 1 in
every pixel. It depends on the pixels per degree of the eye; here it is the evaluator's own number, 67, that of a screen
0.7 m away with 3840 pixels in 0.7 m.
"""

from __future__ import annotations

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import ArrayLike, NDArray

from ...compare import White, srgb_preview

__all__ = ["FLIP_LACKING", "flip_map"]

#: What is said where the evaluator is not installed.
FLIP_LACKING = "FLIP needs its evaluator: pip install 'cboxlab[flip]'"


def flip_map(measured_xyz: ArrayLike, rendered_xyz: ArrayLike, white: White) -> NDArray[np.float64]:
    """FLIP of two pictures, the photograph as reference.

    Both are pictures_8bit as sRGB of 8 bits, the white as white. A pixel that is left out has the same colour in both.

    Parameters
    ----------
    measured_xyz, rendered_xyz
        (y, x, 3) X, Y, Z in the unit of the white's luminance; NaN where left out.
    white
        The lamp's white.

    Returns
    -------
    NDArray
        (y, x) FLIP, 0 to 1; NaN where left out.

    Raises
    ------
    InputError
        If the evaluator is not installed.
    """
    try:
        import flip_evaluator
    except ImportError:
        raise InputError("FLIP", "no package flip-evaluator", "its evaluator", FLIP_LACKING) from None
    pictures = [np.asarray(xyz, float) for xyz in (measured_xyz, rendered_xyz)]
    left_out = ~np.isfinite(np.concatenate(pictures, axis=-1)).all(axis=-1)
    pictures_8bit = [srgb_preview(np.where(left_out[..., None], np.nan, xyz), white) for xyz in pictures]
    reference, test = (np.ascontiguousarray(picture / np.float32(255), np.float32) for picture in pictures_8bit)
    values, _, _ = flip_evaluator.evaluate(reference, test, "LDR", applyMagma=False, computeMeanError=False)
    flat = np.asarray(values, np.float64).reshape(*left_out.shape, -1)[..., 0]
    return np.where(left_out, np.nan, flat)
