"""Competition of the families of explanations for a residual."""

from .competition import MIN_HELDOUT_GAIN_RATIO, NOT_HELD, explain, explain_masked_families
from .explanation import NONE, Explanation, Rival
from .noise import noise_level

__all__ = [
    "MIN_HELDOUT_GAIN_RATIO",
    "NONE",
    "NOT_HELD",
    "Explanation",
    "Rival",
    "explain",
    "explain_masked_families",
    "noise_level",
]
