"""``cboxlab.Study``: a model whose effects are added, changed, fitted and undone."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from numbers import Integral
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from cboxlab.calibration.capture import Capture, load_capture
from cboxlab.rendering.effects import AppliedEffect, Effect, apply_checked, names_in
from cboxlab.rendering.model import Model, named_effect, write_model
from cboxlab.utils.arguments import (
    described,
    require_flag,
    require_progress,
    require_type,
    require_word,
    required_folder,
    required_path,
    required_whole_number,
)
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import suggestion
from cboxlab.utils.progress import NO_PROGRESS, Progress, share
from numpy.typing import NDArray

from .. import diagnose as engine
from ..compare import CalibratedCapture, Validation, prepare, validate_prepared, with_model
from ..predict import effects_key
from ..report import correlation_section, write_validation
from ..study import (
    Base,
    Correlations,
    History,
    Pattern,
    Prediction,
    Profile,
    State,
    StudyFile,
    chi2_profile,
    fitted_correlations,
    pattern_of,
    predict,
    read_study,
    write_study,
)
from .diagnosis import DiagnosisResult
from .inputs import CaptureLike, ModelLike, as_capture, as_model
from .result import Result

__all__ = ["Study"]

#: Number of rendered pictures, and of predictions, kept in memory. Others come from the cache or are rendered again,
#: with the same bits.
MAX_STORED = 4

#: File of a study in its folder.
_STUDY_FILE = "study.json"

#: Share of the time before the first picture that calibration takes.
_CALIBRATION_SHARE = 0.05

Value = TypeVar("Value")


class _RecentStore(Generic[Value]):
    """Values used last; the one not used for the longest time is dropped first."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._values: OrderedDict[Hashable, Value] = OrderedDict()

    def get(self, key: Hashable, compute: Callable[[], Value]) -> Value:
        """Stored value of a key; computed and stored if it is missing."""
        if key not in self._values:
            self._values[key] = compute()
        self._values.move_to_end(key)
        while len(self._values) > self._size:
            self._values.popitem(last=False)
        return self._values[key]


class _Pictures:
    """Pictures and predictions of the calibrated captures, shared by all states of a study."""

    def __init__(self, prepared: tuple[CalibratedCapture, ...], model: Model) -> None:
        self.prepared, self.model = prepared, model
        self._bases: _RecentStore[tuple[Base, ...]] = _RecentStore(MAX_STORED)
        self._predictions: _RecentStore[tuple[Prediction, ...]] = _RecentStore(MAX_STORED)

    def bases(self, effects: Sequence[AppliedEffect], progress: Progress) -> tuple[Base, ...]:
        """Rendered picture of each capture with these effects."""
        model = replace(self.model, effects=tuple(effects))
        return self._bases.get(effects_key(effects), lambda: self._rendered(model, progress))

    def _rendered(self, model: Model, progress: Progress) -> tuple[Base, ...]:
        count, bases = len(self.prepared), []
        for index, each in enumerate(self.prepared):
            base = Base(validate_prepared(each, model, share(progress, index / count, (index + 1) / count)))
            base.prepare()
            bases.append(base)
        return tuple(bases)

    def predicted(self, state: State, refit: bool, draft: bool, progress: Progress) -> tuple[Prediction, ...]:
        """Prediction of each capture in a state."""

        def compute() -> tuple[Prediction, ...]:
            bases = self.bases(state.rendered_with, progress)
            return tuple(predict(base, state.effects, refit=refit, draft=draft) for base in bases)

        key = (effects_key(state.rendered_with), effects_key(state.effects), refit, draft)
        return self._predictions.get(key, compute)


@dataclass(frozen=True, eq=False, repr=False)
class Study(Result):
    """Calibrated captures and a model with effects, its predictions and its history.

    A study never changes. Every step returns another study, which shares calibrations and pictures with this one.
    """

    #: Lists of effects before and after the present one, to undo and redo.
    history: History
    _pictures: _Pictures = field(repr=False)

    @classmethod
    def open(
        cls,
        *captures: CaptureLike,
        model: ModelLike = None,
        noise: float | None = None,
        seed: int | None = None,
        cache: str | Path | None = None,
        progress: Progress = NO_PROGRESS,
    ) -> Study:
        """Calibrate captures of one box, render the model, fit camera and lamp.

        Parameters
        ----------
        *captures
            One capture or several of the same box, or their folders.
        model, noise, seed, cache
            As of ``validate``.
        progress
            Receiver of stages and of the completed share.

        Returns
        -------
        Study
            Study with the model's effects as its first state.

        Raises
        ------
        InputError
            As of ``validate``, for no capture, and if nothing can be compiled (no LLVM, no GPU).

        Examples
        --------
        >>> study = cboxlab.Study.open("capture", model="cornell-box")  # doctest: +SKIP
        >>> brighter = study.add("veiling-glare", fraction=0.003)  # doctest: +SKIP
        >>> brighter.chi2 - study.chi2  # doctest: +SKIP
        """
        if not captures:
            raise InputError("study", "no capture", "one capture or several of the same box")
        require_progress(progress)
        folder = None if cache is None else required_folder("cache", cache)
        loaded = [as_capture(capture) for capture in captures]
        start = as_model(model, loaded, noise=noise, seed=seed)
        progress.stage("calibrating")
        prepared = tuple(replace(prepare(each, start), cache=folder) for each in loaded)
        study = cls(History((State(start.effects, start.effects),)), _Pictures(prepared, start))
        study._bases(share(progress, _CALIBRATION_SHARE, 1.0))
        return study

    @classmethod
    def read(
        cls,
        folder: str | Path,
        *,
        cache: str | Path | None = None,
        calibrated_study: Study | None = None,
        progress: Progress = NO_PROGRESS,
    ) -> Study:
        """Study that ``write`` wrote, with its states to undo and redo.

        Pictures and the fits of camera and lamp come from the cache if it has them. Otherwise they are computed again,
        with the same bits.

        Parameters
        ----------
        folder
            Folder with study.json.
        cache
            As of ``validate``.
        calibrated_study
            Study whose captures are not calibrated again. Other captures are, since their files may have changed.
        progress
            Receiver of stages and of the completed share.

        Returns
        -------
        Study
            The study in the state in which it was written.

        Raises
        ------
        InputError
            If the file is faulty, and as of ``open``.

        Examples
        --------
        >>> study.write("study")  # doctest: +SKIP
        >>> again = cboxlab.Study.read("study")  # doctest: +SKIP
        """
        require_progress(progress)
        cache_folder = None if cache is None else required_folder("cache", cache)
        if calibrated_study is not None:
            require_type("calibrated_study", calibrated_study, Study, "a Study")
        file = read_study(required_path("folder", folder, "the folder of a study") / _STUDY_FILE)
        progress.stage("calibrating")
        calibrated = (
            {}
            if calibrated_study is None
            else {
                capture.folder.resolve(): each
                for capture, each in zip(calibrated_study.captures, calibrated_study.prepared, strict=True)
            }
        )
        prepared = tuple(
            with_model(calibrated[each], file.model)
            if each in calibrated
            else replace(prepare(load_capture(each), file.model), cache=cache_folder)
            for each in file.captures
        )
        study = cls(file.history, _Pictures(prepared, file.model))
        study._bases(share(progress, _CALIBRATION_SHARE, 1.0))
        return study

    def with_model(self, model: ModelLike, progress: Progress = NO_PROGRESS) -> Study:
        """New study of the same captures, without calibrating them again, and another model.

        Parameters
        ----------
        model
            As of ``validate``.
        progress
            Receiver of stages and of the completed share.

        Returns
        -------
        Study
            Study with the model's effects as its first state.

        Raises
        ------
        InputError
            If the model is faulty.
        """
        require_progress(progress)
        start = as_model(model, self.captures)
        prepared = tuple(with_model(each, start) for each in self._pictures.prepared)
        study = Study(History((State(start.effects, start.effects),)), _Pictures(prepared, start))
        study._bases(progress)
        return study

    @property
    def captures(self) -> tuple[Capture, ...]:
        """The checked captures."""
        return tuple(each.calibration.capture for each in self._pictures.prepared)

    @property
    def prepared(self) -> tuple[CalibratedCapture, ...]:
        """The calibrated captures."""
        return self._pictures.prepared

    @property
    def effects(self) -> tuple[AppliedEffect, ...]:
        """The model's effects in order."""
        return self.history.present.effects

    @property
    def model(self) -> Model:
        """The model with its effects."""
        return replace(self._pictures.model, effects=self.effects)

    @property
    def rendered(self) -> bool:
        """Whether the pictures are rendered with the present effects; otherwise predicted."""
        return effects_key(self.history.present.rendered_with) == effects_key(self.effects)

    def predictions(
        self, *, refit: bool = True, draft: bool = False, progress: Progress = NO_PROGRESS
    ) -> tuple[Prediction, ...]:
        """Predicted signals of each capture, compared with the measured ones.

        Repeated calls return the same objects while they are in memory.

        Parameters
        ----------
        refit
            Whether camera and lamp are fitted to each capture with their priors. Otherwise they stay as they were
            fitted to the rendered picture.
        draft
            Whether light transport is predicted with a quarter of the rays, while a parameter is moved.
        progress
            Receiver of stages and of the completed share.

        Returns
        -------
        tuple of Prediction
            One for each capture: signal, standard deviation, chi-square.
        """
        _require_prediction(refit, draft, progress)
        return self._pictures.predicted(self.history.present, refit, draft, progress)

    @property
    def chi2(self) -> float:
        """Reduced chi-square over all captures, with camera and lamp fitted to each."""
        parts = [each.chi2 for each in self.predictions()]
        return sum(each.value for each in parts) / sum(each.dof for each in parts)

    def with_effects(self, effects: Sequence[AppliedEffect]) -> Study:
        """Study with other effects, as a step that can be undone.

        Parameters
        ----------
        effects
            Effects in place of the present ones, in order.

        Returns
        -------
        Study
            The study after the step.
        """
        require_type("effects", effects, Sequence, "a sequence of AppliedEffect")
        for effect in effects:
            require_type("effects", effect, AppliedEffect, "a sequence of AppliedEffect")
        return replace(self, history=self.history.then(effects))

    def add(self, effect: str, /, **values: str | float) -> Study:
        """Study with one more effect.

        Parameters
        ----------
        effect
            Identifier of the catalogue, or an effect file.
        **values
            Parameters. One that is omitted gets its default, or else its null value.

        Returns
        -------
        Study
            The study after the step.

        Raises
        ------
        InputError
            For an unknown effect or parameter, and a value out of bounds.

        Examples
        --------
        >>> study.add("veiling-glare", fraction=0.003).chi2  # doctest: +SKIP
        """
        return self.with_effects((*self.effects, self._checked(named_effect(effect, Path()), values)))

    def change(self, which: int | str, /, **values: str | float) -> Study:
        """Study with other values of one effect.

        Parameters
        ----------
        which
            Index of the effect from 0, or its identifier: the last effect of that name.
        **values
            Parameters to change; the others stay.

        Returns
        -------
        Study
            The study after the step.

        Raises
        ------
        InputError
            For an unknown effect or parameter, and a value out of bounds.
        """
        index = self._index(which)
        old = self.effects[index]
        return self._with(index, self._checked(old.effect, {**old.values, **values}))

    def remove(self, which: int | str, /) -> Study:
        """Study without one effect.

        Parameters
        ----------
        which
            Index of the effect from 0, or its identifier: the last effect of that name.

        Returns
        -------
        Study
            The study after the step.

        Raises
        ------
        InputError
            For an unknown effect.
        """
        index = self._index(which)
        return self.with_effects((*self.effects[:index], *self.effects[index + 1 :]))

    def undo(self) -> Study:
        """Study one state back.

        Returns
        -------
        Study
            The study before the last step; the same study in its first state.
        """
        return replace(self, history=self.history.undone())

    def redo(self) -> Study:
        """Study one state forward.

        Returns
        -------
        Study
            The study before the last ``undo``; the same study if nothing was undone.
        """
        return replace(self, history=self.history.redone())

    def fit(self, *which: int | str, progress: Progress = NO_PROGRESS) -> Study:
        """Study with effects fitted to all captures at the least chi-square, with camera and lamp.

        Parameters
        ----------
        *which
            Index from 0 or identifier of each effect to fit; all effects if none is given.
        progress
            Receiver of stages and of the completed share.

        Returns
        -------
        Study
            The study after the step.

        Raises
        ------
        InputError
            For an unknown effect, and if there is nothing to fit.

        Examples
        --------
        >>> best = study.add("veiling-glare").fit()  # doctest: +SKIP
        """
        require_progress(progress)
        indices = [self._index(each) for each in which] if which else list(range(len(self.effects)))
        bases = self._bases(progress)
        validations = [base.validation for base in bases]
        return self.with_effects(engine.fit_effects(validations, self.effects, sorted(set(indices)), progress))

    def correlations(self, progress: Progress = NO_PROGRESS) -> Correlations | None:
        """Correlations of the numbers that ``fit`` fitted, by the noise of all captures together.

        Parameters
        ----------
        progress
            Receiver of stages and of the completed share.

        Returns
        -------
        Correlations | None
            None if fewer than two numbers are fitted.
        """
        return fitted_correlations(self._bases(progress), self.effects)

    def profile(
        self,
        which: int | str,
        parameter: str,
        /,
        *,
        refit: bool = True,
        draft: bool = False,
        progress: Progress = NO_PROGRESS,
    ) -> Profile:
        """Reduced chi-square over one number of an effect, the other effects held.

        Parameters
        ----------
        which
            Index of the effect from 0, or its identifier: the last effect of that name.
        parameter
            Name of a number of the effect.
        refit
            Whether camera and lamp are fitted at each value.
        draft
            Whether light transport is predicted with a quarter of the rays.
        progress
            Receiver of the completed share.

        Returns
        -------
        Profile
            Values from null to beyond the present value, and chi-square of each capture there.

        Raises
        ------
        InputError
            For an unknown effect, and a parameter that is no number of it.

        Examples
        --------
        >>> curve = study.profile("veiling-glare", "fraction")  # doctest: +SKIP
        >>> curve.best()  # doctest: +SKIP
        """
        index = self._index(which)
        _require_prediction(refit, draft, progress)
        applied = self.effects[index]
        numbers = {each.name: each for each in applied.effect.numbers}
        require_word("parameter", parameter, numbers)
        bases = self._bases(progress)

        def chi2_at(value: float) -> tuple[float, ...]:
            effects = self.change(index, **{parameter: value}).effects
            return tuple(predict(base, effects, refit=refit, draft=draft).chi2.per_dof for base in bases)

        value, sigma = float(applied.values[parameter]), applied.sigma.get(parameter)
        return chi2_profile(applied.id, numbers[parameter], value, sigma, chi2_at, progress)

    def patterns(
        self, effect: str, /, capture: int = 0, *, refit: bool = True, draft: bool = False, **values: str | float
    ) -> tuple[Pattern, ...]:
        """Changes of the picture by each number of an effect that is not in the model.

        Parameters
        ----------
        effect
            Identifier of the catalogue, or an effect file.
        capture
            Index of the capture, from 0.
        refit
            Whether camera and lamp are fitted to the changed picture, so that only what they leave is shown.
        draft
            Whether light transport is predicted with a quarter of the rays.
        **values
            Other parameters, such as the material; one that is omitted gets its default.

        Returns
        -------
        tuple of Pattern
            One for each number with a null value, at a value that changes a hundredth of the samples by three standard
            deviations or more.

        Raises
        ------
        InputError
            For an unknown effect or parameter.
        """
        _require_prediction(refit, draft, NO_PROGRESS)
        capture = self._capture(capture)
        base = self._bases(NO_PROGRESS)[capture]
        without = predict(base, self.effects, refit=refit, draft=draft)
        checked = self._checked(named_effect(effect, Path()), values)
        numbers = checked.effect.within(self.prepared[capture].scene).numbers

        def change(parameter: str, value: float) -> NDArray[np.float64]:
            effects = self.add(effect, **{**values, parameter: value}).effects
            present = predict(base, effects, refit=refit, draft=draft)
            return np.asarray((present.signal - without.signal) / without.sigma)

        with_null = [each for each in numbers if each.null is not None]
        return tuple(pattern_of(each, partial(change, each.name)) for each in with_null or numbers)

    def render(self, progress: Progress = NO_PROGRESS) -> Study:
        """Study with pictures rendered with the present effects, as ``validate`` renders them.

        Parameters
        ----------
        progress
            Receiver of stages and of the completed share.

        Returns
        -------
        Study
            The study in the same state of its history, with exact pictures.
        """
        study = replace(self, history=self.history.rendered())
        study._bases(progress)
        return study

    def validations(self, progress: Progress = NO_PROGRESS) -> tuple[Validation, ...]:
        """Complete validation of the model with its effects by each capture.

        Parameters
        ----------
        progress
            Receiver of stages and of the completed share.

        Returns
        -------
        tuple of Validation
            One for each capture; pictures that were only predicted are rendered first.
        """
        return tuple(base.validation for base in self.render(progress)._bases(progress))

    def diagnose(self, capture: int = 0, progress: Progress = NO_PROGRESS) -> DiagnosisResult:
        """Diagnosis of one capture, starting from the model with its effects.

        Parameters
        ----------
        capture
            Index of the capture, from 0.
        progress
            Receiver of stages and of the completed share.

        Returns
        -------
        DiagnosisResult
            Its effects are adopted by ``with_effects(result.diagnosis.model.effects)``.
        """
        require_progress(progress)
        index = self._capture(capture)
        validation = self.validations(share(progress, 0.0, 0.3))[index]
        return DiagnosisResult(engine.diagnose_validation(validation, share(progress, 0.3, 1.0)), validation)

    def to_dict(self) -> dict[str, Any]:
        """Effects, and chi-square, lamp and camera of each capture.

        Returns
        -------
        dict
            Ready for JSON; an infinite value of a parameter is "inf".
        """
        return {
            "model": self.model.name,
            "effects": [{"id": e.id, "values": _finite(e.values), "sigma": dict(e.sigma)} for e in self.effects],
            "rendered": self.rendered,
            "chi2_per_dof": self.chi2,
            "captures": [
                {
                    "capture": capture.manifest.name or capture.folder.name,
                    "chi2_per_dof": each.chi2.per_dof,
                    "lamp_scale": each.rendered.fit.lamp_scale,
                    "camera": each.rendered.fit.camera.parameters.tolist(),
                }
                for capture, each in zip(self.captures, self.predictions(), strict=True)
            ],
        }

    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """Write study.json, which ``read`` reads, and model.toml.

        Parameters
        ----------
        folder
            Folder of the files.

        Returns
        -------
        tuple of Path
            study.json first.
        """
        target = required_folder("folder", folder)
        study, model = target / _STUDY_FILE, target / "model.toml"
        write_model(model, self.model)
        write_study(study, StudyFile(tuple(c.folder for c in self.captures), self.model, self.history))
        return study, model

    def write_report(self, folder: str | Path, capture: int = 0, progress: Progress = NO_PROGRESS) -> tuple[Path, ...]:
        """Write report.html, metrics.json and maps of one capture.

        Parameters
        ----------
        folder
            Folder of the files.
        capture
            Index of the capture, from 0.
        progress
            Receiver of stages and of the completed share.

        Returns
        -------
        tuple of Path
            report.html first. A picture that was only predicted is rendered before.
        """
        require_progress(progress)
        target, index = required_folder("folder", folder), self._capture(capture)
        matrix = self.correlations(progress)
        sections = () if matrix is None else (correlation_section(matrix.names, matrix.values, matrix.sentences),)
        return write_validation(self.validations(progress)[index], target, sections=sections)

    def lines(self) -> list[str]:
        """Reduced chi-square, then the effects.

        Returns
        -------
        list of str
            One line for each effect, with its index from 0.
        """
        how = "rendered" if self.rendered else "predicted"
        names = ", ".join(capture.manifest.name or capture.folder.name for capture in self.captures)
        head = f"{names} against {self.model.name}: χ² per degree of freedom {self.chi2:.3f} ({how})"
        return [head, *(_effect_line(index, effect) for index, effect in enumerate(self.effects))]

    def _with(self, index: int, effect: AppliedEffect) -> Study:
        return self.with_effects((*self.effects[:index], effect, *self.effects[index + 1 :]))

    def _checked(self, effect: str | Effect | None, values: dict[str, str | float]) -> AppliedEffect:
        """Effect with checked values, for the scene and bands of the captures."""
        prepared = self._pictures.prepared[0]
        bands = tuple(prepared.calibration.capture.band_ids)
        return apply_checked(effect, values, "effect", names_in(prepared.scene, bands))

    def _index(self, which: int | str) -> int:
        """Index of an effect by index or identifier."""
        names = [effect.id for effect in self.effects]
        if isinstance(which, str) and which in names:
            return len(names) - 1 - names[::-1].index(which)
        if isinstance(which, Integral) and not isinstance(which, bool) and 0 <= which < len(names):
            return int(which)
        value = described(which) if names else f"{described(which)} in a model without effects"
        expected = f"one of {', '.join(names)}, or its index from 0" if names else "an effect that was added"
        hint = suggestion(which, names) if isinstance(which, str) else ""
        raise InputError("effect", value, expected, hint)

    def _capture(self, capture: int) -> int:
        """Index of a capture, checked."""
        return required_whole_number("capture", capture, 0, len(self._pictures.prepared) - 1)

    def _bases(self, progress: Progress) -> tuple[Base, ...]:
        return self._pictures.bases(self.history.present.rendered_with, progress)


def _require_prediction(refit: bool, draft: bool, progress: Progress) -> None:
    require_flag("refit", refit)
    require_flag("draft", draft)
    require_progress(progress)


def _finite(values: Any) -> dict[str, str | float]:
    """Values for JSON, which lacks infinity."""
    return {key: "inf" if value == float("inf") else value for key, value in values.items()}


def _effect_line(index: int, effect: AppliedEffect) -> str:
    values = ", ".join(
        f"{key} = {value if isinstance(value, str) else format(value, '.5g')}"
        + (f" ± {effect.sigma[key]:.2g}" if key in effect.sigma else "")
        for key, value in effect.values.items()
    )
    return f"{index}. {effect.id}: {values}"
