"""Study: captures, a model's effects in order, and predictions; every state is a value."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .correlations import HARDLY_DISTINGUISHED, Correlations, fitted_correlations
    from .history import History, State
    from .pattern import Pattern, pattern_of
    from .prediction import Base, Prediction, predict, same_effects
    from .profile import Profile, chi2_profile
    from .study_file import StudyFile, read_study, write_study

__all__ = [
    "HARDLY_DISTINGUISHED",
    "Base",
    "Correlations",
    "History",
    "Pattern",
    "Prediction",
    "Profile",
    "State",
    "StudyFile",
    "chi2_profile",
    "fitted_correlations",
    "pattern_of",
    "predict",
    "read_study",
    "same_effects",
    "write_study",
]

__getattr__, __dir__ = lazy_names(__name__)
