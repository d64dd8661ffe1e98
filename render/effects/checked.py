"""Effects of other packages: their record, and what their function returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from cboxlab.scenes.scene import Scene
from cboxlab.utils.errors import InputError
from cboxlab.utils.other_packages import guarded, is_identifier, is_tuple_of, require_fields
from numpy.typing import NDArray

from ..chain import STAGES, Stage
from .effect import Effect, Parameter

__all__ = ["checked_effect"]


def checked_effect(effect: Effect, where: str) -> Effect:
    """Effect of another package whose function's faults are InputErrors.

    Parameters
    ----------
    effect
        The effect as the package has it.
    where
        The entry point, for messages.

    Returns
    -------
    Effect
        A copy. Its function raises InputError where that of the package raises any exception or changes its input.
        So it does for a returned value of another type or shape, or with numbers that are not finite.

    Raises
    ------
    InputError
        For fields of another type than those of ``Effect``.
    """
    texts = (effect.summary, effect.confirm, effect.title)
    sound = {
        "id": is_identifier(effect.id),
        "stage": isinstance(effect.stage, str) and effect.stage in STAGES,
        "parameters": is_tuple_of(Parameter, effect.parameters),
        "apply": callable(effect.apply),
        "summary, confirm or title": is_tuple_of(str, texts),
        "sources": is_tuple_of(str, effect.sources),
    }
    require_fields(where, effect, sound)
    return replace(effect, apply=_Checked(effect.apply, effect.stage, where))


@dataclass(frozen=True)
class _Checked:
    """Function of an effect whose faults are InputErrors."""

    #: The package's function.
    apply: Callable[..., Any]
    #: Stage of the chain at which it acts.
    stage: Stage
    #: The entry point, for messages.
    where: str

    def __call__(self, value: Any, *context: Any, **values: Any) -> Any:
        kind = STAGES[self.stage]
        expected = f"a changed copy of the {kind.__name__} from its function"
        before = {name: array.copy() for name, array in _arrays(value).items()}
        with guarded(self.where, expected):
            changed = self.apply(value, *context, **values)
        if not isinstance(changed, kind):
            raise InputError(self.where, f"a {type(changed).__name__} from its function", expected)
        for name, array in _arrays(value).items():
            if not np.array_equal(array, before[name], equal_nan=True):
                raise InputError(self.where, f"its input's {name} changed in place", expected)
        for name, array in _arrays(changed).items():
            old = before.get(name)
            if old is not None and self.stage != "scene" and array.shape != old.shape:
                raise InputError(self.where, f"{name} of shape {array.shape}", f"shape {old.shape}, as in its input")
            if not np.isfinite(array).all() and (old is None or np.isfinite(old).all()):
                raise InputError(self.where, f"{name} with numbers that are not finite", "finite numbers")
        return changed


def _arrays(value: Any) -> dict[str, NDArray]:
    """Numbers of a stage's value by name, those of a scene's surfaces for a scene."""
    if isinstance(value, Scene):
        return {f"vertices of {surface.name}": surface.vertices_mm for surface in value.all_surfaces}
    entries = {f.name: getattr(value, f.name) for f in fields(value)} if is_dataclass(value) else {}
    arrays = {k: np.asarray(v) for k, v in entries.items() if isinstance(v, float | np.ndarray)}
    return {name: array for name, array in arrays.items() if array.dtype.kind == "f"}
