"""Form factors in closed form."""

import numpy as np

__all__ = ["corner_to_rectangle"]


def corner_to_rectangle(a: float, b: float, c: float) -> float:
    """Form factor from a point to a rectangle with a corner straight above it (Howell, B-3).

    The rectangle is parallel to the surface at the point.

    Parameters
    ----------
    a, b
        Sides of the rectangle.
    c
        Distance of the point, in the same unit.

    Returns
    -------
    float
        Form factor, 0 to 1.
    """
    x, y = a / c, b / c
    return float(
        (
            x / np.sqrt(1 + x * x) * np.arctan(y / np.sqrt(1 + x * x))
            + y / np.sqrt(1 + y * y) * np.arctan(x / np.sqrt(1 + y * y))
        )
        / (2 * np.pi)
    )
