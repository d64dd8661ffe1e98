"""Competition of the families of explanations for a residual."""

from .competition import explain, explain_masked_families
from .explanation import NONE, SOUND, Explanation, Rival
from .imitation import LEAST_PROBABILITY, Signs, imitation_probability
from .laboratory import advice, appearance
from .motion import Motion, motions
from .noise import noise_level
from .registration import Registration, registration
from .repeats import FrameAmplitudes, flicker_of, frame_amplitudes, lead_of_frames
from .rival_form import Lead, lead_of_forms, rival_forms

__all__ = [
    "LEAST_PROBABILITY",
    "NONE",
    "SOUND",
    "Explanation",
    "FrameAmplitudes",
    "Lead",
    "Motion",
    "Registration",
    "Rival",
    "Signs",
    "advice",
    "appearance",
    "explain",
    "explain_masked_families",
    "flicker_of",
    "frame_amplitudes",
    "imitation_probability",
    "lead_of_forms",
    "lead_of_frames",
    "motions",
    "noise_level",
    "registration",
    "rival_forms",
]
