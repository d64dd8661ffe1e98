"""Workbench: a study, a trial while a slider moves, and a diagnosis. It knows no web server."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.chain import stages_between
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.model import load_model
from cboxlab.scenes.scene_file import PACKAGED, packaged_scenes
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import inputs_below
from cboxlab.utils.progress import Progress, share

from ...api import DiagnosisResult, Study, as_model
from ...study import Correlations, History, Pattern, Prediction, Profile, same_effects
from .autosave import AUTOSAVE_FOLDER, autosave, discard_autosave
from .places import path_of_name, require_study_folder

__all__ = ["EarlierStateError", "Workbench"]

#: Number of changes whose chi-square is stored.
_MAX_MOVES = 200

#: Stages whose effects the patch predictor approximates.
_APPROXIMATED = stages_between("scene", "transport")


class EarlierStateError(InputError):
    """A step that was made on an earlier state of the study, in another tab."""


def _same_states(first: History, second: History) -> bool:
    """Whether two histories have the same effects in all their states, whatever was rendered."""
    effects = [[state.effects for state in history.states] for history in (first, second)]
    return first.at == second.at and len(effects[0]) == len(effects[1]) and all(map(same_effects, *effects))


class Workbench:
    """State of the workbench: a study, the capture in view, and a diagnosis.

    Parameters
    ----------
    root
        Folder below which captures and models are opened and results are saved.
    cache
        Folder that keeps renderings; None keeps nothing.
    noise
        Noise of the rendering, in place of the model's.
    seed
        Seed of the rendering, in place of the model's.
    """

    def __init__(
        self, root: Path, cache: Path | None = None, noise: float | None = None, seed: int | None = None
    ) -> None:
        self.root, self.cache = root, cache
        self._noise, self._seed = noise, seed
        self._study: Study | None = None
        self._trial: Study | None = None
        #: Index of the capture in view.
        self.capture = 0
        #: Whether camera and lamp are fitted at every step.
        self.refit = True
        #: Last diagnosis; None before one.
        self.diagnosis: DiagnosisResult | None = None
        #: Number of changes of the study and of the capture in view. A step names the one that it was made on.
        self.revision = 0
        #: Reduced chi-square of the capture in view after each change since the study was opened.
        self.moves: list[float] = []
        self._saved: History | None = None
        self._unsaved: Path | None = None
        self._correlations: tuple[tuple[AppliedEffect, ...], Correlations | None] = (), None
        self._profile: tuple[tuple[AppliedEffect, ...], int, Profile] | None = None

    @property
    def study(self) -> Study:
        """The open study; InputError before one is open."""
        if self._study is None:
            raise InputError("the workbench", "no capture", "an open capture", "Open one.")
        return self._study

    @property
    def is_saved(self) -> bool:
        """Whether the study has no states that ``save`` or ``open`` did not have."""
        if self._study is None:
            return True
        return self._saved is not None and _same_states(self._study.history, self._saved)

    @property
    def unsaved_folder(self) -> Path | None:
        """Folder of the study's unsaved work; None before it has any."""
        return self._unsaved

    def require_revision(self, revision: int) -> None:
        """Require that a step was made on the present state.

        Parameters
        ----------
        revision
            Number of the state on which it was made.

        Raises
        ------
        EarlierStateError
            If the study has changed since.
        """
        if revision != self.revision:
            hint = "The page shows the present state now. Repeat the step."
            raise EarlierStateError("the step", "one made on an earlier state of the study", "the present state", hint)

    @property
    def is_open(self) -> bool:
        """Whether a study is open."""
        return self._study is not None

    @property
    def study_in_view(self) -> Study:
        """The study in view: the trial while a slider moves."""
        return self._trial or self.study

    @property
    def prediction(self) -> Prediction:
        """Prediction of the capture in view."""
        return self.predictions[self.capture]

    @property
    def predictions(self) -> tuple[Prediction, ...]:
        """Prediction of each capture; a draft if light transport is predicted."""
        return self._predicted(self.study_in_view)

    def _predicted(self, study: Study) -> tuple[Prediction, ...]:
        return study.predictions(refit=self.refit, draft=True)

    @property
    def correlations(self) -> Correlations | None:
        """Correlations of the numbers fitted last; None for other effects."""
        effects, matrix = self._correlations
        return matrix if same_effects(effects, self.study_in_view.effects) else None

    @property
    def profile(self) -> tuple[int, Profile] | None:
        """Index of an effect, and chi-square over one of its numbers.

        None before one is computed, and once anything but this number has changed.
        """
        if self._profile is None:
            return None
        effects, which, profile = self._profile
        present = self.study_in_view.effects
        if len(effects) != len(present) or effects[which].id != present[which].id:
            return None
        name = profile.parameter.name
        as_then = replace(present[which], values={**present[which].values, name: effects[which].values[name]})
        same = same_effects(effects, (*present[:which], as_then, *present[which + 1 :]))
        return (which, profile) if same else None

    @property
    def improvable(self) -> bool:
        """Whether light transport is predicted, so that rendering would improve the picture."""
        if self._study is None:
            return False
        present = self._study.history.present
        approximated = [
            [effect for effect in effects if effect.stage in _APPROXIMATED]
            for effects in (present.effects, present.rendered_with)
        ]
        return not same_effects(*approximated)

    def open(self, capture: str | Path, model: str | Path | None, progress: Progress) -> None:
        """Open a capture with a model, or a saved study; calibrate and render.

        A capture that is open already is not calibrated again.

        Parameters
        ----------
        capture
            Folder of a capture, or of a saved study (with study.json).
        model
            Model or scene file, or the name of a packaged scene. None for the box that the capture states.
        progress
            Receiver of stages and of the completed share.

        Raises
        ------
        InputError
            If an input is faulty or outside the root folder. A ``Path`` comes from the program: then no input is
            refused for its folder.
        """
        if isinstance(capture, Path):
            self._open(capture, model, progress)
        else:
            with self._inputs():
                self._open(path_of_name(self.root, capture, "capture"), model, progress)

    def _inputs(self) -> AbstractContextManager[None]:
        """Refusal of files outside the root folder and the open captures."""
        captures = () if self._study is None else [capture.folder for capture in self._study.captures]
        return inputs_below(self.root, PACKAGED, *captures)

    def _open(self, folder: Path, model: str | Path | None, progress: Progress) -> None:
        if (folder / "study.json").exists() and not (folder / "capture.toml").exists():
            study = Study.read(folder, cache=self.cache, calibrated_study=self._study, progress=progress)
            self._begin(study, folder if folder.parent == self.root / AUTOSAVE_FOLDER else None)
            return
        loaded = load_capture(folder)
        start = as_model(self._model(model), [loaded], noise=self._noise, seed=self._seed)
        if self._study is not None and [c.folder.resolve() for c in self._study.captures] == [folder.resolve()]:
            self._begin(self._study.with_model(start, progress))
        else:
            self._begin(Study.open(loaded, model=start, cache=self.cache, progress=progress))

    def open_model(self, model: str | Path, progress: Progress) -> None:
        """Open another model for the same captures.

        Parameters
        ----------
        model
            Model or scene file, or the name of a packaged scene.
        progress
            Receiver of stages and of the completed share.

        Raises
        ------
        InputError
            If the model is faulty or outside the root folder, or if no capture is open.
        """
        with self._inputs():
            start = as_model(self._model(model), self.study.captures, noise=self._noise, seed=self._seed)
        self._begin(self.study.with_model(start, progress))

    def _model(self, name: str | Path | None) -> Any:
        if not name:
            return None
        return load_model(name if name in packaged_scenes() else path_of_name(self.root, name, "model"))

    def _effect(self, name: str) -> str:
        return str(path_of_name(self.root, name, "effect")) if name.endswith(".toml") else name

    def _begin(self, study: Study, unsaved: Path | None = None) -> None:
        """Set a study of other inputs, without a diagnosis; unsaved work is in a folder."""
        self._predicted(study)
        self.capture, self.diagnosis, self.moves = 0, None, []
        self._unsaved, self._saved = unsaved, study.history if unsaved is None else None
        self._set(study)

    def _take(self, study: Study) -> None:
        """Set the study, if it can be predicted; otherwise InputError, and the old study stays."""
        self._predicted(study)
        self._set(study)

    def _set(self, study: Study) -> None:
        """Set a study whose prediction is computed, and keep unsaved work in a file."""
        self._study, self._trial = study, None
        self.revision += 1
        self.moves = [*self.moves, float(self.prediction.chi2.per_dof)][-_MAX_MOVES:]
        if not self.is_saved:
            self._unsaved = autosave(self.root, study, self._unsaved)

    def add(self, effect: str, values: Mapping[str, str | float]) -> None:
        """Add an effect.

        Parameters
        ----------
        effect, values
            As of ``Study.add``.

        Raises
        ------
        InputError
            As of ``Study.add``.
        """
        with self._inputs():
            study = self.study.add(self._effect(effect), **values)
        self._take(study)

    def change(self, which: int, values: Mapping[str, str | float], commit: bool) -> None:
        """Change an effect's parameters.

        Parameters
        ----------
        which, values
            As of ``Study.change``.
        commit
            Whether it is a step that can be undone; otherwise a trial, which the next step replaces.

        Raises
        ------
        InputError
            As of ``Study.change``.
        """
        moved = self.study.change(which, **values)
        if commit:
            self._take(moved)
        else:
            self._predicted(moved)
            self._trial = moved

    def remove(self, which: int) -> None:
        """Remove an effect.

        Parameters
        ----------
        which
            Index of the effect, from 0.
        """
        self._take(self.study.remove(which))

    def undo(self) -> None:
        """Go one state back."""
        self._take(self.study.undo())

    def redo(self) -> None:
        """Go one state forward."""
        self._take(self.study.redo())

    def show(self, capture: int, refit: bool) -> None:
        """Choose the capture in view, and whether camera and lamp are fitted.

        Parameters
        ----------
        capture
            Index of the capture, from 0.
        refit
            Whether camera and lamp are fitted at every step. Otherwise they stay as they were fitted to the picture.

        Raises
        ------
        InputError
            For an index without a capture.
        """
        if not 0 <= capture < len(self.study.captures):
            raise InputError("capture", str(capture), f"0 to {len(self.study.captures) - 1}")
        if capture != self.capture:
            self.moves = []
        self.capture, self.refit = capture, refit
        self._take(self.study)

    def fit(self, which: list[int], progress: Progress) -> None:
        """Fit effects.

        Parameters
        ----------
        which
            Indices of effects, from 0; all effects if empty.
        progress
            Receiver of stages and of the completed share.
        """
        self._take(self.study.fit(*which, progress=progress))
        self._correlations = self.study.effects, self.study.correlations(progress)

    def render(self, progress: Progress) -> None:
        """Render the pictures with the present effects.

        Parameters
        ----------
        progress
            Receiver of stages and of the completed share.
        """
        study = self.study.render(progress)
        self._predicted(study)
        self._set(study)

    def compute_profile(self, which: int, parameter: str, progress: Progress) -> None:
        """Compute chi-square over one number of an effect, for ``profile``.

        Parameters
        ----------
        which
            Index of the effect, from 0.
        parameter
            Name of the number.
        progress
            Receiver of the completed share.
        """
        study = self.study
        profile = study.profile(which, parameter, refit=self.refit, draft=True, progress=progress)
        self._profile = study.effects, which, profile

    def patterns(self, effect: str) -> tuple[Pattern, ...]:
        """Changes of the picture in view by each number of an effect, which is not added.

        Parameters
        ----------
        effect
            Identifier of the effect.

        Returns
        -------
        tuple of Pattern
            As of ``Study.patterns``.
        """
        with self._inputs():
            return self.study.patterns(self._effect(effect), self.capture, refit=self.refit, draft=True)

    def earlier(self, is_first: bool) -> Prediction:
        """Prediction of the capture in view in an earlier state of the study.

        Parameters
        ----------
        is_first
            Whether it is the first state; otherwise the one before the last change.

        Returns
        -------
        Prediction
            Prediction of the earlier state; of the present one if there is none.
        """
        history = self.study.history
        effects = history.states[0 if is_first else max(history.at - 1, 0)].effects
        # from the present picture, which is in memory
        return self._predicted(self.study.with_effects(effects))[self.capture]

    def diagnose(self, progress: Progress) -> None:
        """Diagnose the capture in view, starting from the model with its effects.

        Parameters
        ----------
        progress
            Receiver of stages and of the completed share.
        """
        self.render(share(progress, 0.0, 0.3))
        self.diagnosis = self.study.diagnose(self.capture, share(progress, 0.3, 1.0))

    def adopt(self) -> None:
        """Replace the effects with those of the diagnosis."""
        if self.diagnosis is None:
            raise InputError("the workbench", "no diagnosis", "a finished diagnosis", "Run it first.")
        self._take(self.study.with_effects(self.diagnosis.diagnosis.model.effects))

    def save(self, folder: str, report: bool, progress: Progress) -> list[str]:
        """Write study.json and model.toml, and on request report.html, metrics.json and maps.

        A diagnosis that started from the present effects or led to them is written with a report, in the folder
        diagnosis.

        Parameters
        ----------
        folder
            Folder below the root folder; it is created if it is missing.
        report
            Whether to render the pictures and write the report.
        progress
            Receiver of stages and of the completed share.

        Returns
        -------
        list of str
            Paths of the files.

        Raises
        ------
        InputError
            If the folder is outside the root folder, or has files other than a study's.
        """
        target = path_of_name(self.root, folder, "folder", new=True)
        require_study_folder(self.root, target)
        written = [*self.study.write(target)]
        self._saved = self.study.history
        discard_autosave(self._unsaved)
        self._unsaved = None
        if report:
            self.render(progress)
            written = [*self.study.write(target), *self.study.write_report(target, self.capture)]
            if self.diagnosis is not None and self._concerns_study(self.diagnosis):
                written += self.diagnosis.write(target / "diagnosis")
        return [str(path) for path in written]

    def _concerns_study(self, result: DiagnosisResult) -> bool:
        """Whether a diagnosis started from the present effects, or led to them."""
        ends = result.validation.model.effects, result.diagnosis.model.effects
        return any(same_effects(effects, self.study.effects) for effects in ends)
