"""Hypotheses: an effect of the catalogue with its choices made and its numbers free."""

from .hypothesis import (
    Hypothesis,
    hypotheses,
)

__all__ = [
    "Hypothesis",
    "hypotheses",
]
