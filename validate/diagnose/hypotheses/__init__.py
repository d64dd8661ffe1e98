"""Hypotheses: an effect of the catalogue with its choices made and its numbers free."""

from .hypothesis import (
    Hypothesis,
    hypotheses,
)
from .levels import (
    CERTAIN_SIGMA,
    EXACT_SHAPE_ERROR,
    FALSE_ALARM,
    INDISTINGUISHABLE_CHI2,
    LIKELY,
    MIN_HELDOUT_GAIN,
    SHAPE_ERROR,
    SIGNIFICANT_SIGMA,
)

__all__ = [
    "CERTAIN_SIGMA",
    "EXACT_SHAPE_ERROR",
    "FALSE_ALARM",
    "INDISTINGUISHABLE_CHI2",
    "LIKELY",
    "MIN_HELDOUT_GAIN",
    "SHAPE_ERROR",
    "SIGNIFICANT_SIGMA",
    "Hypothesis",
    "hypotheses",
]
