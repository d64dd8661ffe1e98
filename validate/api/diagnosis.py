"""``cboxlab.diagnose``: which physical effect the model lacks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cboxlab.calibration.capture import Capture
from cboxlab.rendering.files import AS_STATED, Declared
from cboxlab.rendering.model import write_model
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS, Progress, share

from ..compare import Validation
from ..diagnose import Diagnosis
from ..diagnose import diagnose as diagnosed
from ..report import (
    diagnosis_record,
    finding_sentences,
    ranked_values,
    write_diagnosis,
    write_validation,
)
from .inputs import ModelLike, as_capture
from .result import Result
from .validation import ValidationResult, validate

__all__ = ["DiagnosisResult", "diagnose"]

_MOST_RANKED = 3

#: Part of the time that the validation before a diagnosis takes.
_VALIDATION = 0.3


@dataclass(frozen=True, eq=False, repr=False)
class DiagnosisResult(Result):
    """diagnosis : ranking, path and the model with the effects found. validation : of the model as given."""

    diagnosis: Diagnosis
    validation: Validation

    def to_dict(self) -> dict[str, Any]:
        """The content of diagnosis.json (docs/diagnosis.md)."""
        return diagnosis_record(self.diagnosis)

    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """diagnosis.json, model.toml with the effects found; report.html, metrics.json and maps of the validation."""
        place = Path(folder)
        diagnosis, model = place / "diagnosis.json", place / "model.toml"
        written = write_validation(self.validation, place, self.diagnosis)
        write_model(model, self.diagnosis.model)
        write_diagnosis(diagnosis, self.diagnosis)
        return (diagnosis, model, *written)

    def lines(self) -> list[str]:
        """The finding in sentences, then the effects that explain most when tried alone."""
        ranked = [
            f"{rank}. {entry.effect}: {ranked_values(entry)}; probability {100 * entry.probability:.1f} %"
            for rank, entry in enumerate(self.diagnosis.ranking[:_MOST_RANKED], 1)
        ]
        return [*finding_sentences(self.diagnosis), *ranked]


def diagnose(
    capture: Capture | ValidationResult | str | Path,
    *further: Capture | ValidationResult | str | Path,
    model: ModelLike = None,
    render: str | Path | None = None,
    noise: float | None = None,
    seed: int | None = None,
    cache: str | Path | None = None,
    declared: Declared = AS_STATED,
    progress: Progress = NO_PROGRESS,
) -> DiagnosisResult:
    """Name the effects that the model lacks, fit them and show the error falling.

    capture : as of ``validate``, or its result, which is then not computed again; the other arguments are those of
    ``validate``. further : other captures of the same box, which decide between effects that the first one cannot tell
    apart. Raises InputError as ``validate`` does, where nothing can be compiled (no LLVM, no GPU), and for another
    renderer's picture with several captures.
    """
    if render is not None and further:
        raise InputError("diagnose", "another renderer's picture and several captures", "one capture with a picture")
    captures = [one if isinstance(one, ValidationResult) else as_capture(one) for one in (capture, *further)]
    validations = []
    for index, one in enumerate(captures):
        if not isinstance(one, ValidationResult):
            part = share(progress, *(_VALIDATION * k / len(captures) for k in (index, index + 1)))
            one = validate(
                one,
                model=model,
                render=render,
                noise=noise,
                seed=seed,
                cache=cache,
                declared=declared,
                progress=part,
            )
        validations.append(one.validation)
    found = diagnosed(validations[0], share(progress, _VALIDATION, 1.0), validations[1:])
    return DiagnosisResult(found, validations[0])
