"""What the workbench does: a study with its history, a trial while a slider moves, a diagnosis. No web in here."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.chain import stages_between
from cboxlab.rendering.model import load_model
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import Progress, share

from ...api import DiagnosisResult, Study, as_model
from ...study import Prediction, same_effects
from .places import chosen_place

__all__ = ["Workbench"]

#: Stages whose effects the patch predictor approximates.
_APPROXIMATED = stages_between("scene", "transport")


class Workbench:
    """root : the folder in which captures and models are opened and results saved. cache : see ``Study.open``.

    noise, seed : of the render in place of the model's.
    """

    def __init__(
        self, root: Path, cache: Path | None = None, noise: float | None = None, seed: int | None = None
    ) -> None:
        self.root, self.cache = root, cache
        self._noise, self._seed = noise, seed
        self._study: Study | None = None
        self._trial: Study | None = None
        self.capture, self.refit = 0, True
        self.found: DiagnosisResult | None = None

    @property
    def study(self) -> Study:
        """The study at hand. Raises InputError before one was opened."""
        if self._study is None:
            raise InputError("the workbench", "no capture", "an open capture", "Open one")
        return self._study

    @property
    def is_open(self) -> bool:
        """Whether there is a study."""
        return self._study is not None

    @property
    def shown(self) -> Study:
        """The study as it is shown: the trial while a slider moves."""
        return self._trial or self.study

    @property
    def prediction(self) -> Prediction:
        """Of the capture that is shown."""
        return self.predictions[self.capture]

    @property
    def predictions(self) -> tuple[Prediction, ...]:
        """Of all captures: drafts, where light transport is predicted, until it is rendered."""
        return self._predicted(self.shown)

    def _predicted(self, study: Study) -> tuple[Prediction, ...]:
        return study.predictions(refit=self.refit, draft=True)

    @property
    def improvable(self) -> bool:
        """Whether light transport is predicted that could be rendered."""
        if self._study is None:
            return False
        present = self._study.history.present
        kept = [
            [effect for effect in effects if effect.stage in _APPROXIMATED]
            for effects in (present.effects, present.rendered_with)
        ]
        return not same_effects(*kept)

    def open(self, capture: str | Path, model: str | Path | None, progress: Progress) -> None:
        """Open a capture with a model, or a saved study (a folder with study.json); calibrate and render.

        A capture that is open already is not calibrated again. Raises InputError.
        """
        folder = chosen_place(self.root, capture, "capture")
        if (folder / "study.json").exists() and not (folder / "capture.toml").exists():
            self._begin(Study.read(folder, cache=self.cache, known=self._study, progress=progress))
            return
        loaded = load_capture(folder)
        chosen = as_model(self._model(model), [loaded], noise=self._noise, seed=self._seed)
        if self._study is not None and [c.folder.resolve() for c in self._study.captures] == [folder.resolve()]:
            self._begin(self._study.with_model(chosen, progress))
        else:
            self._begin(Study.open(loaded, model=chosen, cache=self.cache, progress=progress))

    def open_model(self, model: str | Path, progress: Progress) -> None:
        """Take another model for the captures that are open."""
        chosen = as_model(self._model(model), self.study.captures, noise=self._noise, seed=self._seed)
        self._begin(self.study.with_model(chosen, progress))

    def _model(self, name: str | Path | None) -> Any:
        if name is None or not str(name).endswith(".toml"):
            return None if not name else load_model(str(name))
        return load_model(chosen_place(self.root, name, "model"))

    def _begin(self, study: Study) -> None:
        self._take(study)
        self.capture, self.found = 0, None

    def _take(self, study: Study) -> None:
        self._predicted(study)  # what cannot be predicted is refused, and the study stays as it was
        self._study, self._trial = study, None

    def add(self, effect: str, values: Mapping[str, str | float]) -> None:
        """Add an effect. Raises InputError as ``Study.add``."""
        self._take(self.study.add(effect, **values))

    def change(self, which: int, values: Mapping[str, str | float], commit: bool) -> None:
        """Move an effect's parameters; without ``commit`` as a trial, which leaves no state behind."""
        moved = self.study.change(which, **values)
        if commit:
            self._take(moved)
        else:
            self._predicted(moved)
            self._trial = moved

    def remove(self, which: int) -> None:
        """Take an effect out."""
        self._take(self.study.remove(which))

    def undo(self) -> None:
        """One state back."""
        self._take(self.study.undo())

    def redo(self) -> None:
        """One state forward."""
        self._take(self.study.redo())

    def show(self, capture: int, refit: bool) -> None:
        """Show another of the captures, or hold camera and lamp where they were fitted."""
        if not 0 <= capture < len(self.study.captures):
            raise InputError("capture", str(capture), f"0 to {len(self.study.captures) - 1}")
        self.capture, self.refit = capture, refit
        self._take(self.study)

    def fit(self, which: list[int], progress: Progress) -> None:
        """Fit these effects, all where the list is empty."""
        self._take(self.study.fit(*which, progress=progress))

    def render(self, progress: Progress) -> None:
        """Render the picture with the effects as they are."""
        study = self.study.render(progress)
        self._predicted(study)
        self._study, self._trial = study, None

    def diagnose(self, progress: Progress) -> None:
        """Find what the model lacks, on top of its effects."""
        self.render(share(progress, 0.0, 0.3))
        self.found = self.study.diagnose(self.capture, share(progress, 0.3, 1.0))

    def adopt(self) -> None:
        """Take the effects that the diagnosis found."""
        if self.found is None:
            raise InputError("the workbench", "no diagnosis", "one that has ended", "Run it")
        self._take(self.study.with_effects(self.found.diagnosis.model.effects))

    def save(self, folder: str, report: bool, progress: Progress) -> list[str]:
        """Write study.json and model.toml, and with ``report`` report.html, metrics.json and maps.

        Returns the files' paths. A diagnosis that started from the present effects or led to them is written beside it.
        """
        place = chosen_place(self.root, folder, "folder", new=True)
        written = [*self.study.write(place)]
        if report:
            self.render(progress)
            written = [*self.study.write(place), *self.study.write_report(place, self.capture)]
            if self.found is not None and self._found_of(self.found):
                written += self.found.write(place / "diagnosis")
        return [str(path) for path in written]

    def _found_of(self, found: DiagnosisResult) -> bool:
        """Whether a diagnosis started from the present effects, or led to them."""
        ends = found.validation.model.effects, found.diagnosis.model.effects
        return any(same_effects(effects, self.study.effects) for effects in ends)
