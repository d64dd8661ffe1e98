"""Public functions of ``cboxlab``, and their results."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .calibration import CalibrationResult, calibrate
    from .cube import CubeFile, CubeResult, CubeSettings, render, render_file
    from .diagnosis import DiagnosisResult, diagnose
    from .inputs import ModelLike, as_model
    from .raw_frame import RawFrame, simulate
    from .result import Result
    from .result_manifest import MANIFEST, Verification, is_current, verify, write_manifest
    from .study import Study
    from .validation import ValidationResult, validate

__all__ = [
    "MANIFEST",
    "CalibrationResult",
    "CubeFile",
    "CubeResult",
    "CubeSettings",
    "DiagnosisResult",
    "ModelLike",
    "RawFrame",
    "Result",
    "Study",
    "ValidationResult",
    "Verification",
    "as_model",
    "calibrate",
    "diagnose",
    "is_current",
    "render",
    "render_file",
    "simulate",
    "validate",
    "verify",
    "write_manifest",
]

__getattr__, __dir__ = lazy_names(__name__)
