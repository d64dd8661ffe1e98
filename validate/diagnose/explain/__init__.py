"""Competition of the families of explanations for a residual."""

from .competition import explain, explain_masked_families
from .explanation import NONE, Explanation, Rival
from .noise import noise_level

__all__ = [
    "NONE",
    "Explanation",
    "Rival",
    "explain",
    "explain_masked_families",
    "noise_level",
]
