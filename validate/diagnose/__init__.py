"""Missing effects of a model: hypotheses, screening, fits, selection, held-out tests."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .alternatives import LikelyCause
    from .base_flaws import Flaw
    from .diagnosis import Diagnosis, diagnose_validation
    from .effect_fit import fit_effect, fit_effects
    from .evidence import Limit
    from .further_captures import Separation
    from .judgement import Verdict
    from .linear_model import nuisance_priors
    from .results import Ranked, Step
    from .search import judged_by_priors
    from .several_captures import FurtherCaptureResult

__all__ = [
    "Diagnosis",
    "Flaw",
    "FurtherCaptureResult",
    "LikelyCause",
    "Limit",
    "Ranked",
    "Separation",
    "Step",
    "Verdict",
    "diagnose_validation",
    "fit_effect",
    "fit_effects",
    "judged_by_priors",
    "nuisance_priors",
]

__getattr__, __dir__ = lazy_names(__name__)
