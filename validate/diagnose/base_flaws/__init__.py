"""Small flaws of a sound box, lens or flat, as fields with priors."""

from .columns import FlawColumns, flaw_columns
from .fitted_flaws import FittedFlaws, Flaw, FlawModel, build_flaw_model
from .lens import CORNER_PX, LENS
from .parts import PartAmplitudes

__all__ = [
    "CORNER_PX",
    "LENS",
    "FittedFlaws",
    "Flaw",
    "FlawColumns",
    "FlawModel",
    "PartAmplitudes",
    "build_flaw_model",
    "flaw_columns",
]
