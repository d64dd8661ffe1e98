"""Blur that grows towards the corners of the picture.

A lens has its best focus on a curved surface. Beyond it a point is a spot whose radius grows with the square of the
distance from the axis, and in higher orders with the fourth and eighth power. Off the axis a point is also a line
towards it, by coma in proportion to the distance, by astigmatism to its square (W. T. Welford, "Aberrations of Optical
Systems", 1986). The change of the picture is in proportion to the variance of the spot, the square of its size.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from cboxlab.rendering.perturbation import Warp, warp_change
from numpy.typing import NDArray

__all__ = ["CORNER_PX", "LENS", "soft_corners"]

#: Kind of these flaws.
LENS = "lens"

#: Standard deviation of the blur in the farthest corner, px: sound lenses lose a part of a pixel there. Corners of 0.2
#: to 0.4 px in sound captures by an outside simulator are fitted with 0.4 to 1.2 of the tolerance.
CORNER_PX = 0.25

#: Powers of the distance from the axis with which the radius of a round spot grows.
_ROUND_POWERS = (2, 4, 8)

#: The same of the length of a line towards the axis, less 1.
_FURTHER_RADIAL_POWERS = (0, 1)

#: Numerics: motion of the farthest corner by which lines are computed, px: by less, the steps in which coverage is
#: known count (cosine with the change by motions of 0.3 px everywhere: 0.77 at 0.25 px, 0.94 at 0.4 px).
_STEP_PX = 0.4


def soft_corners(
    blurred: NDArray[np.float64], used: NDArray[np.bool_], warp: Warp, level: float
) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Changes of the used samples by each order of a lens's spots, one standard deviation each.

    Parameters
    ----------
    blurred
        (band, y, x) change of the signal by a blur of ``CORNER_PX`` everywhere, DN.
    used
        (band, y, x) True for the n samples.
    warp
        The picture taken apart by faces.
    level
        Signal over that of the warp, DN.

    Returns
    -------
    Iterator of tuple
        Form, "lens:round" or "lens:radial", and (n,) change, DN.
    """
    camera = warp.camera
    rows, columns = np.indices(used.shape[1:])
    away_px = np.hypot(columns - camera.principal_point_px[0], rows - camera.principal_point_px[1])
    distance, step = away_px / away_px.max(), _STEP_PX / away_px.max()
    for power in _ROUND_POWERS:
        yield f"{LENS}:round", (distance ** (2 * power) * blurred)[used]
    # a line is two pictures, one larger and one smaller: each point moves in proportion to its distance
    sizes = (replace(camera, focal_length_px=camera.focal_length_px / (1 + sign * step)) for sign in (1, -1))
    line = level * (CORNER_PX / _STEP_PX) ** 2 * np.mean([warp_change(warp, size) for size in sizes], axis=0)
    for power in _FURTHER_RADIAL_POWERS:
        yield f"{LENS}:radial", (distance ** (2 * power) * line)[used]
