"""Gradient over the picture: a factor that grows evenly from side to side."""

from __future__ import annotations

from collections.abc import Iterator

from .cause import Cause, Pictures, Trial

__all__ = ["CAUSE"]


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """With and without a factor on all light."""
    x, y = pictures.across()
    base = pictures.baseline
    slopes = (base * x[..., None], base * y[..., None])
    yield Trial(lambda a: {"to_the_right": float(a[0]), "downwards": float(a[1])}, slopes)
    yield Trial(
        lambda a: {"to_the_right": float(a[0]), "downwards": float(a[1]), "factor": 1 + float(a[2])}, (*slopes, base)
    )


CAUSE = Cause(
    "gradient",
    "A factor grows evenly over the picture, by these parts in half its width.",
    _trials,
    is_factor=True,
)
