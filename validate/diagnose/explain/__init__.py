"""Competition of the families of explanations for a residual."""

from .competition import MIN_HELDOUT_GAIN, explain, explain_masked_families
from .explanation import NONE, SOUND, Explanation, Rival
from .imitation import LEAST_PROBABILITY, LIKELY, Signs, imitation_probability
from .laboratory import advice, appearance
from .noise import noise_level
from .registration import Registration, registration
from .rival_form import Lead, lead_of_forms, rival_forms

__all__ = [
    "LEAST_PROBABILITY",
    "LIKELY",
    "MIN_HELDOUT_GAIN",
    "NONE",
    "SOUND",
    "Explanation",
    "Lead",
    "Registration",
    "Rival",
    "Signs",
    "advice",
    "appearance",
    "explain",
    "explain_masked_families",
    "imitation_probability",
    "lead_of_forms",
    "noise_level",
    "registration",
    "rival_forms",
]
