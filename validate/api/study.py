"""``cboxlab.Study``: captures and a model under the hand. Effects are added, moved, fitted, taken back."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from cboxlab.calibration.capture import Capture, load_capture
from cboxlab.rendering.effects import AppliedEffect, Effect, apply_checked, names_in
from cboxlab.rendering.model import Model, named_effect, write_model
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import suggestion
from cboxlab.utils.progress import NO_PROGRESS, Progress, share

from ..compare import CalibratedCapture, Validation, prepare, validate_prepared, with_model
from ..diagnose import diagnose as diagnosed
from ..diagnose import fit_effects
from ..report import write_validation
from ..study import Base, History, Prediction, State, StudyFile, predict, read_study, write_study
from .diagnosis import DiagnosisResult
from .inputs import CaptureLike, ModelLike, as_capture, as_model
from .result import Result

__all__ = ["Study"]

#: So many rendered pictures are kept in memory; others are found in the cache or rendered again, with the same bits.
_KEPT = 4

_FILE = "study.json"

#: Part of the time before the first picture that calibration takes.
_CALIBRATION = 0.05


class _Pictures:
    """Pictures rendered so far, by the effects that they were rendered with; shared by all states of a study."""

    def __init__(self, prepared: tuple[CalibratedCapture, ...], model: Model) -> None:
        self.prepared, self.model = prepared, model
        self._bases: OrderedDict[tuple, tuple[Base, ...]] = OrderedDict()
        self.predictions: OrderedDict[tuple, tuple[Prediction, ...]] = OrderedDict()

    def bases(self, effects: Sequence[AppliedEffect], progress: Progress) -> tuple[Base, ...]:
        """One picture per capture, rendered now or before."""
        key = _key(effects)
        if key not in self._bases:
            self._bases[key] = self._rendered(replace(self.model, effects=tuple(effects)), progress)
        return _recent(self._bases, key)

    def _rendered(self, model: Model, progress: Progress) -> tuple[Base, ...]:
        count, found = len(self.prepared), []
        for index, each in enumerate(self.prepared):
            base = Base(validate_prepared(each, model, share(progress, index / count, (index + 1) / count)))
            base.prepare()
            found.append(base)
        return tuple(found)

    def predicted(self, state: State, refit: bool, draft: bool, progress: Progress) -> tuple[Prediction, ...]:
        """One prediction per capture, made now or before."""
        key = (_key(state.rendered_with), _key(state.effects), refit, draft)
        if key not in self.predictions:
            bases = self.bases(state.rendered_with, progress)
            self.predictions[key] = tuple(predict(base, state.effects, refit=refit, draft=draft) for base in bases)
        return _recent(self.predictions, key)


def _key(effects: Sequence[AppliedEffect]) -> tuple:
    return tuple((e.id, tuple(e.values.items())) for e in effects)


def _recent(kept: OrderedDict[tuple, Any], key: tuple) -> Any:
    kept.move_to_end(key)
    while len(kept) > _KEPT:
        kept.popitem(last=False)
    return kept[key]


@dataclass(frozen=True, eq=False, repr=False)
class Study(Result):
    """Calibrated captures, a model's effects in order, what they predict, and all states before.

    A study never changes: every step returns another one, which shares what was calibrated and rendered.
    """

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

        captures, model, noise, seed, cache : as of ``validate``. Raises InputError as ``validate`` does, for no
        capture, and where nothing can be compiled (no LLVM, no GPU).
        """
        if not captures:
            raise InputError("study", "no capture", "one capture or several of the same box")
        loaded = [as_capture(capture) for capture in captures]
        chosen = as_model(model, loaded, noise=noise, seed=seed)
        progress.stage("calibrating")
        kept = None if cache is None else Path(cache)
        prepared = tuple(replace(prepare(each, chosen), cache=kept) for each in loaded)
        study = cls(History((State(chosen.effects, chosen.effects),)), _Pictures(prepared, chosen))
        study._bases(share(progress, _CALIBRATION, 1.0))
        return study

    @classmethod
    def read(
        cls,
        folder: str | Path,
        *,
        cache: str | Path | None = None,
        known: Study | None = None,
        progress: Progress = NO_PROGRESS,
    ) -> Study:
        """A study that ``write`` wrote, with its states to undo and redo.

        known : a study whose captures are not calibrated again. Others are, since their files may have changed. Its
        pictures and the fits of camera and lamp come from the cache where they are there, and are made again
        otherwise, with the same bits. Raises InputError for a faulty file, and as ``open`` does.
        """
        file = read_study(Path(folder) / _FILE)
        progress.stage("calibrating")
        kept = None if cache is None else Path(cache)
        calibrated = (
            {}
            if known is None
            else {capture.folder.resolve(): each for capture, each in zip(known.captures, known.prepared, strict=True)}
        )
        prepared = tuple(
            with_model(calibrated[each], file.model)
            if each in calibrated
            else replace(prepare(load_capture(each), file.model), cache=kept)
            for each in file.captures
        )
        study = cls(file.history, _Pictures(prepared, file.model))
        study._bases(share(progress, _CALIBRATION, 1.0))
        return study

    def with_model(self, model: ModelLike, progress: Progress = NO_PROGRESS) -> Study:
        """A new study of the same captures, which are not calibrated again, and another model."""
        chosen = as_model(model, self.captures)
        prepared = tuple(with_model(each, chosen) for each in self._pictures.prepared)
        study = Study(History((State(chosen.effects, chosen.effects),)), _Pictures(prepared, chosen))
        study._bases(progress)
        return study

    @property
    def captures(self) -> tuple[Capture, ...]:
        """The captures, checked."""
        return tuple(each.calibration.capture for each in self._pictures.prepared)

    @property
    def prepared(self) -> tuple[CalibratedCapture, ...]:
        """The captures, calibrated."""
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
        """Whether the pictures were rendered with the present effects; otherwise they are predicted from others."""
        return _key(self.history.present.rendered_with) == _key(self.effects)

    def predictions(
        self, *, refit: bool = True, draft: bool = False, progress: Progress = NO_PROGRESS
    ) -> tuple[Prediction, ...]:
        """What the model predicts of each capture, compared with it; made once.

        refit : whether camera and lamp are fitted to it within what is known of them, or stay as they were fitted.
        draft : whether light transport is predicted with a quarter of the rays, for a parameter in motion.
        """
        return self._pictures.predicted(self.history.present, refit, draft, progress)

    @property
    def chi2(self) -> float:
        """Chi-square per degree of freedom over all captures, camera and lamp fitted in each."""
        found = [each.chi2 for each in self.predictions()]
        return sum(each.value for each in found) / sum(each.dof for each in found)

    def with_effects(self, effects: Sequence[AppliedEffect]) -> Study:
        """With these effects in place of the present ones, as a step that can be undone."""
        return replace(self, history=self.history.then(effects))

    def add(self, effect: str, /, **values: str | float) -> Study:
        """With one more effect, of the catalogue or of an effect file; parameters left out get their default, or else
        their null value.

        Raises InputError for an unknown effect or parameter, and a value out of bounds.
        """
        return self.with_effects((*self.effects, self._checked(named_effect(effect, Path()), values)))

    def change(self, which: int | str, /, **values: str | float) -> Study:
        """With other values of one effect. which : its index, or its identifier (the last effect of that name)."""
        index = self._index(which)
        old = self.effects[index]
        return self._with(index, self._checked(old.effect, {**old.values, **values}))

    def remove(self, which: int | str, /) -> Study:
        """Without one effect. which : as of ``change``."""
        index = self._index(which)
        return self.with_effects((*self.effects[:index], *self.effects[index + 1 :]))

    def undo(self) -> Study:
        """The state before; the first one stays."""
        return replace(self, history=self.history.undone())

    def redo(self) -> Study:
        """The state that was undone; the last one stays."""
        return replace(self, history=self.history.redone())

    def fit(self, *which: int | str, progress: Progress = NO_PROGRESS) -> Study:
        """With one, several or (none named) all effects fitted to all captures together, camera and lamp fitted too.

        which : as of ``change``. Raises InputError where nothing can be fitted.
        """
        chosen = [self._index(each) for each in which] if which else list(range(len(self.effects)))
        bases = self._bases(progress)
        validations = [base.validation for base in bases]
        return self.with_effects(fit_effects(validations, self.effects, sorted(set(chosen)), progress))

    def render(self, progress: Progress = NO_PROGRESS) -> Study:
        """With the pictures rendered with the present effects, as ``validate`` of this model does it; no new state."""
        study = replace(self, history=self.history.rendered())
        study._bases(progress)
        return study

    def validations(self, progress: Progress = NO_PROGRESS) -> tuple[Validation, ...]:
        """The complete validation of the model with its effects by each capture; rendered where it was predicted."""
        return tuple(base.validation for base in self.render(progress)._bases(progress))

    def diagnose(self, capture: int = 0, progress: Progress = NO_PROGRESS) -> DiagnosisResult:
        """What the model with its effects lacks in one capture; ``with_effects(result.diagnosis.model.effects)``
        adopts it."""
        validation = self.validations(share(progress, 0.0, 0.3))[capture]
        return DiagnosisResult(diagnosed(validation, share(progress, 0.3, 1.0)), validation)

    def to_dict(self) -> dict[str, Any]:
        """Captures, effects, chi-square and nuisances of each capture."""
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
        """study.json, which ``read`` reads, and model.toml."""
        place = Path(folder)
        study, model = place / _FILE, place / "model.toml"
        write_model(model, self.model)
        write_study(study, StudyFile(tuple(c.folder for c in self.captures), self.model, self.history))
        return study, model

    def write_report(self, folder: str | Path, capture: int = 0, progress: Progress = NO_PROGRESS) -> tuple[Path, ...]:
        """report.html, metrics.json and maps of one capture, rendered first where it was predicted."""
        return write_validation(self.validations(progress)[capture], Path(folder))

    def lines(self) -> list[str]:
        """Chi-square, then the effects."""
        how = "rendered" if self.rendered else "predicted"
        names = ", ".join(capture.manifest.name or capture.folder.name for capture in self.captures)
        head = f"{names} against {self.model.name}: χ² per degree of freedom {self.chi2:.3f} ({how})"
        return [head, *(_shown(index, effect) for index, effect in enumerate(self.effects))]

    def _with(self, index: int, effect: AppliedEffect) -> Study:
        return self.with_effects((*self.effects[:index], effect, *self.effects[index + 1 :]))

    def _checked(self, effect: str | Effect | None, values: dict[str, str | float]) -> AppliedEffect:
        prepared = self._pictures.prepared[0]
        bands = tuple(prepared.calibration.capture.band_ids)
        return apply_checked(effect, values, "effect", names_in(prepared.scene, bands))

    def _index(self, which: int | str) -> int:
        known = [effect.id for effect in self.effects]
        if isinstance(which, str) and which in known:
            return len(known) - 1 - known[::-1].index(which)
        if isinstance(which, int) and 0 <= which < len(known):
            return which
        found = repr(which) if known else f"{which!r} in a model without effects"
        expected = f"one of {', '.join(known)}, or its index from 0" if known else "an effect that was added"
        raise InputError("effect", found, expected, suggestion(str(which), known))

    def _bases(self, progress: Progress) -> tuple[Base, ...]:
        return self._pictures.bases(self.history.present.rendered_with, progress)


def _finite(values: Any) -> dict[str, str | float]:
    return {key: "inf" if value == float("inf") else value for key, value in values.items()}


def _shown(index: int, effect: AppliedEffect) -> str:
    values = ", ".join(
        f"{key} = {value if isinstance(value, str) else format(value, '.5g')}"
        + (f" ± {effect.sigma[key]:.2g}" if key in effect.sigma else "")
        for key, value in effect.values.items()
    )
    return f"{index}. {effect.id}: {values}"
