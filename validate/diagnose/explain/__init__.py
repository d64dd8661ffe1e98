"""Competition of the families of explanations for a residual."""

from .competition import MIN_HELDOUT_GAIN, explain, explain_masked_families
from .explanation import NONE, SOUND, Explanation, Rival
from .imitation import LEAST_PROBABILITY, Signs, imitation_probability
from .laboratory import advice, appearance
from .noise import noise_level
from .registration import Registration, registration

__all__ = [
    "LEAST_PROBABILITY",
    "MIN_HELDOUT_GAIN",
    "NONE",
    "SOUND",
    "Explanation",
    "Registration",
    "Rival",
    "Signs",
    "advice",
    "appearance",
    "explain",
    "explain_masked_families",
    "imitation_probability",
    "noise_level",
    "registration",
]
