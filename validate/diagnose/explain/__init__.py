"""What no catalogue holds: families of linear fields, fitted to a residual as competitors."""

from .excess import Excess, Transport
from .explanation import FAMILIES, NONE, Explanation, Rival, explain, hidden, noise_level

__all__ = [
    "FAMILIES",
    "NONE",
    "Excess",
    "Explanation",
    "Rival",
    "Transport",
    "explain",
    "hidden",
    "noise_level",
]
