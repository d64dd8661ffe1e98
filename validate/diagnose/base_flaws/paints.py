"""Paints that differ from their tables slowly over wavelength.

A spectrophotometer misses a reflectance by a little, and more in the blue than in the red or the reverse; a wall is not
the sample that was measured. All surfaces of the paint change, and the surfaces that they light. The change follows the
patch transport of the picture.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from cboxlab.rendering.perturbation import PatchLight
from numpy.typing import NDArray

__all__ = ["paints"]

#: Standard deviation of each wave over wavelength, relative to the reflectance: together 0.2 % (rms). The national
#: scale of reflectance is uncertain by half of that (0.2 to 0.25 %, k = 2; "NPL scales for radiance factor and total
#: diffuse reflectance", Metrologia 40, 2003), and a laboratory transfers it to a sample, and the sample to a wall.
_PAINT_TOLERANCE = 0.00115

#: Largest order of the waves over wavelength: changes narrower than 75 nm are no error of a scale.
_WAVE_ORDER = 4

#: Wavelengths between which a wave of order 1 goes from its highest to its lowest value, nm: the visible range.
_RANGE_NM = (400.0, 700.0)

#: Numerics: relative change of reflectance by which the derivative is taken: far from the rounding of single precision.
_STEP = 0.01


def paints(
    signal: NDArray[np.float64], used: NDArray[np.bool_], light: PatchLight
) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Changes of the used samples by each paint's spectrum, one standard deviation each.

    Parameters
    ----------
    signal
        (band, y, x) predicted signal, DN.
    used
        (band, y, x) True for the n samples.
    light
        Light of the picture by patch transport.

    Returns
    -------
    Iterator of tuple
        "paints", and (n,) change, DN.
    """
    before = light.picture()
    first, last = _RANGE_NM
    position = (light.wavelength_nm - first) / (last - first)
    of_patch, of_fragment = light.transport.light.patches.material, light.transport.material
    for material in np.unique(of_fragment[of_fragment < len(light.scene.materials)]):
        changed = light.change(
            patch_reflectance=light.patch_reflectance * (1 + _STEP * (of_patch == material))[:, None],
            fragment_reflectance=light.fragment_reflectance * (1 + _STEP * (of_fragment == material))[:, None],
        )
        change = (changed.picture() - before) / _STEP
        relative = np.divide(change, before, out=np.zeros_like(before), where=before > 0)
        for order in range(_WAVE_ORDER + 1):
            wave = np.cos(np.pi * order * position)[:, None, None]
            yield "paints", (_PAINT_TOLERANCE * wave * relative * signal)[used]
