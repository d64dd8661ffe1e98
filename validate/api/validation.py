"""``cboxlab.validate``: a capture compared with the render of a model."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any
from uuid import uuid4

from cboxlab.rendering.files import AS_STATED, Declared
from cboxlab.utils.progress import NO_PROGRESS, Progress

from ..compare import HEADLINE, Validation, failures, validate_capture
from ..report import chi2_by_place, validation_record, verdict, write_validation
from ..report.viewer import viewer_data, viewer_fragment
from .inputs import CaptureLike, ModelLike, as_capture, as_model
from .result import Result

__all__ = ["ValidationResult", "validate"]

_MOST_FAILURES = 3


@dataclass(frozen=True, eq=False, repr=False)
class ValidationResult(Result):
    """validation : calibration, render, fit and comparison as objects."""

    validation: Validation

    def to_dict(self) -> dict[str, Any]:
        """The content of metrics.json (docs/metrics.md)."""
        return validation_record(self.validation)

    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """report.html, metrics.json and the maps (EXR)."""
        return write_validation(self.validation, Path(folder))

    def _repr_html_(self) -> str:
        """In a notebook: the result in a few lines, and the viewer of photograph and render."""
        text = "".join(f"<p>{escape(line)}</p>" for line in self.lines())
        return text + viewer_fragment(viewer_data(self.validation), f"viewer-{uuid4().hex}")

    def lines(self) -> list[str]:
        """The verdict, the headline figures, and where the model fails most."""
        found, c = self.validation, self.validation.comparison
        manifest = found.prepared.calibration.capture
        name = manifest.manifest.name or manifest.folder.name
        lines = [
            f"{name} against {found.model.name}: {verdict(c).headline}",
            f"χ² per degree of freedom {c.chi2.per_dof:.3f} ({chi2_by_place(c)}), mean {HEADLINE.label} "
            f"{c.colour[HEADLINE.id].mean:.2f} (noise alone {c.colour_noise[HEADLINE.id].mean:.2f}), "
            f"lamp × {found.fit.lamp_scale:.4f}",
        ]
        ranked = failures(found)[1][:_MOST_FAILURES]
        return lines + [f"{rank}. {failure.sentence}" for rank, failure in enumerate(ranked, 1)]


def validate(
    capture: CaptureLike,
    *,
    model: ModelLike = None,
    render: str | Path | None = None,
    noise: float | None = None,
    seed: int | None = None,
    cache: str | Path | None = None,
    declared: Declared = AS_STATED,
    progress: Progress = NO_PROGRESS,
) -> ValidationResult:
    """Calibrate a capture, render a model through its camera, compare.

    capture : its folder, or what ``load_capture`` returned. model : a Model, a model file or a packaged scene's name;
    where None the box that the capture states, or the published one. render : another renderer's spectral cube (.nc,
    .exr, .hdr) in place of our picture.
    noise, seed : of the render, in place of the model's; noise is the median over the pixels of the render's standard
    deviation over the sensor's. cache : a folder that keeps rendered pictures from run to run, None for nowhere.
    declared : units and wavelengths of ``render`` where the file does not state them.

    Raises InputError for faulty input, and for a capture that lacks what a comparison with a render takes.
    """
    loaded = as_capture(capture)
    chosen = as_model(model, [loaded], noise=noise, seed=seed)
    picture, folder = (None if path is None else Path(path) for path in (render, cache))
    return ValidationResult(validate_capture(loaded, chosen, progress, picture, folder, declared))
