"""``cboxlab.diagnose``: the physical effects that a model lacks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cboxlab.rendering.files import AS_STATED, Declared
from cboxlab.rendering.model import write_model
from cboxlab.utils.arguments import require_progress, required_folder
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS, Progress, share
from cboxlab.utils.table import Table

from .. import diagnose as engine
from ..compare import HEADLINE, Predicted, Validation, failures
from ..report import (
    ReportSection,
    comparison_figure,
    correlation_section,
    diagnosis_record,
    finding_sentences,
    named_bands,
    ranked_values,
    step_name,
    write_diagnosis,
    write_validation,
)
from ..study import Base, fitted_correlations
from .calibration import suspicion_lines
from .inputs import CaptureLike, ModelLike, as_capture
from .result import Result
from .validation import MAX_FAILURES, ValidationResult, validate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["DiagnosisResult", "diagnose"]

#: Largest number of effects listed that were tried alone: more are in diagnosis.json.
MAX_RANKED = 6

#: Share of the time that the validation before a diagnosis takes, for progress: about a third at 128 x 128 x 7.
_VALIDATION_SHARE = 0.3


@dataclass(frozen=True, eq=False, repr=False)
class DiagnosisResult(Result):
    """The effects that a model lacks, and the fall of the error as they are added."""

    #: Ranking, path, and the model with the effects added.
    diagnosis: engine.Diagnosis
    #: Validation of the model as given.
    validation: Validation

    def to_dict(self) -> dict[str, Any]:
        """Content of diagnosis.json (docs/reference/files.md).

        Returns
        -------
        dict
            Ranking, selected effects, path, and what remains.
        """
        return diagnosis_record(self.diagnosis)

    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """Write diagnosis.json, model.toml, and the report, metrics and maps of the validation.

        Parameters
        ----------
        folder
            Folder of the files.

        Returns
        -------
        tuple of Path
            diagnosis.json first, then model.toml with the effects added.
        """
        target = required_folder("folder", folder)
        diagnosis, model = target / "diagnosis.json", target / "model.toml"
        files = write_validation(self.validation, target, self.diagnosis, self._correlation_sections())
        write_model(model, self.diagnosis.model)
        write_diagnosis(diagnosis, self.diagnosis)
        return (diagnosis, model, *files)

    def _correlation_sections(self) -> tuple[ReportSection, ...]:
        """Section on the correlations of the fitted numbers, if there are two or more."""
        if not self.diagnosis.path or not isinstance(self.validation.rendered, Predicted):
            return ()
        last = self.diagnosis.path[-1]
        added = tuple(replace(e, sigma=sigma) for e, sigma in zip(last.effects, last.sigma, strict=True))
        base_effects = tuple(replace(e, sigma={}) for e in self.validation.model.effects)
        matrix = fitted_correlations([Base(self.validation)], (*base_effects, *added))
        return () if matrix is None else (correlation_section(matrix.names, matrix.values, matrix.sentences),)

    def plot(self) -> Figure:
        """Figure of the difference over its standard deviation, by band.

        Returns
        -------
        Figure
            ``figure("difference")``, which a notebook shows.
        """
        return self.figure("difference")

    def figure(self, what: str = "difference") -> Figure:
        """Figure of the comparison with the effects found; the one before is ``validate``'s.

        Parameters
        ----------
        what
            As of ``ValidationResult.figure``.

        Returns
        -------
        Figure
            Matplotlib figure, ready for ``savefig``.

        Raises
        ------
        InputError
            For another name.
        """
        comparison = self.diagnosis.path[-1].comparison
        return comparison_figure(comparison, named_bands(comparison.bands, self.validation.prepared.responses), what)

    def lines(self) -> list[str]:
        """Findings, suspicions, and the places where the model as given fails most.

        Returns
        -------
        list of str
            The sentences.
        """
        ranked = failures(self.validation)[1][:MAX_FAILURES]
        return [
            *finding_sentences(self.diagnosis),
            *suspicion_lines(self.validation.prepared.calibration),
            *(f"{rank}. {failure.sentence}" for rank, failure in enumerate(ranked, 1)),
        ]

    def tables(self) -> list[Table]:
        """Effects tried alone, and the error after each step.

        Returns
        -------
        list of Table
            In the first, chi-square counts possible errors of the rendering as noise, and camera and lamp are refitted
            with each effect. In the second it counts the noise alone: the sensor's, and the rendering's, stated over
            the sensor's. The last column is the distance of camera and lamp from the survey.
        """
        single_effects = tuple(
            (r.effect, ranked_values(r), f"{r.chi2_per_dof:.4f}", f"{100 * r.probability:.1f} %")
            for r in self.diagnosis.ranking[:MAX_RANKED]
        )
        steps = tuple(
            (
                step_name(step),
                f"{step.comparison.chi2.per_dof:.3f}",
                f"{step.comparison.colour[HEADLINE.id].mean:.3f}",
                f"{step.comparison.colour_noise[HEADLINE.id].mean:.3f}",
                f"{step.comparison.render_sigma_over_sensor_sigma:.2f}",
                f"{step.prior_pull:.1f}",
            )
            for step in self.diagnosis.path
        )
        return [
            Table(
                "Effects tried alone. χ²/dof includes possible errors of the rendering in the noise",
                ("effect", "parameters", "χ²/dof", "probability"),
                single_effects,
                text_columns=(0, 1),
            ),
            Table(
                "Error after each step. χ²/dof includes the noise of camera and rendering alone",
                ("model", "χ²/dof", HEADLINE.label, "noise alone", "rendering noise", "from survey, σ"),
                steps,
            ),
        ]


def diagnose(
    capture: CaptureLike | ValidationResult,
    *further: CaptureLike | ValidationResult,
    model: ModelLike = None,
    render: str | Path | None = None,
    noise: float | None = None,
    seed: int | None = None,
    cache: str | Path | None = None,
    declared: Declared = AS_STATED,
    progress: Progress = NO_PROGRESS,
) -> DiagnosisResult:
    """Name the effects that the model lacks, fit them, and add them until noise is left.

    Parameters
    ----------
    capture
        A capture, its folder, or the result of ``validate``, which is then not computed again.
    *further
        Other captures of the same box, which decide between effects that the first one cannot separate.
    model, render, noise, seed, cache, declared
        As of ``validate``.
    progress
        Receiver of stages and of the completed share.

    Returns
    -------
    DiagnosisResult
        Ranking, selected effects with their sizes, and what remains.

    Raises
    ------
    InputError
        If an input is faulty, if nothing can be compiled (no LLVM, no GPU), or for another renderer's cube with several
        captures.

    Examples
    --------
    >>> diagnosis = cboxlab.diagnose("capture")  # doctest: +SKIP
    >>> diagnosis.to_dict()["selected"]  # doctest: +SKIP
    """
    require_progress(progress)
    if render is not None and further:
        raise InputError("diagnose", "another renderer's picture and several captures", "one capture with a picture")
    inputs = [item if isinstance(item, ValidationResult) else as_capture(item) for item in (capture, *further)]
    validations = []
    for index, item in enumerate(inputs):
        if not isinstance(item, ValidationResult):
            first, last = (_VALIDATION_SHARE * count / len(inputs) for count in (index, index + 1))
            item = validate(
                item,
                model=model,
                render=render,
                noise=noise,
                seed=seed,
                cache=cache,
                declared=declared,
                progress=share(progress, first, last),
            )
        validations.append(item.validation)
    diagnosis = engine.diagnose_validation(validations[0], share(progress, _VALIDATION_SHARE, 1.0), validations[1:])
    return DiagnosisResult(diagnosis, validations[0])
