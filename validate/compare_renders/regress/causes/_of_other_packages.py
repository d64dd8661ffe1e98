"""Causes of other packages: their record, and what their functions give."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.utils.other_packages import checked_function, checked_generator, require, require_fields

from .cause import Cause, Pictures, Trial

__all__ = ["checked_cause"]

#: Requirement of the function of a cause, in messages.
_TRIALS = "trials from its function"
#: Requirement of the parameters of a trial.
_PARAMETERS = "parameters by name, or None"


def checked_cause(cause: Cause, where: str) -> Cause:
    """Cause of another package whose functions' faults are InputErrors.

    Parameters
    ----------
    cause
        The cause as the package has it.
    where
        The entry point or the file, for messages.

    Returns
    -------
    Cause
        A copy. Its functions raise InputError where those of the package raise any exception, or give a value of
        another type, of another shape, or with numbers that are not finite.

    Raises
    ------
    InputError
        For fields of another type than those of ``Cause``.
    """
    sound = {
        "id": isinstance(cause.id, str) and 0 < len(cause.id) <= 64 and cause.id.isprintable(),
        "summary": isinstance(cause.summary, str),
        "trials": callable(cause.trials),
        "shape_error": _share(cause.shape_error),
        "edge_error": _share(cause.edge_error),
    }
    require_fields(where, cause, sound)

    def parameters(value: Any, *arguments: Any) -> Mapping[str, Any] | None:
        _require_parameters(value, where)
        return value

    def trial(value: Any, pictures: Pictures) -> Trial:
        _require_trial(value, pictures, where)
        return replace(value, parameters=checked_function(value.parameters, where, _PARAMETERS, parameters))

    return replace(cause, trials=checked_generator(cause.trials, where, _TRIALS, trial))


def _share(value: object) -> bool:
    return isinstance(value, int | float) and bool(np.isfinite(value)) and value >= 0


def _require_trial(trial: Any, pictures: Pictures, where: str) -> None:
    """Check the templates of a trial. Raises InputError for a faulty one."""
    require(isinstance(trial, Trial), where, f"a {type(trial).__name__}", _TRIALS)
    require(callable(trial.parameters), where, "parameters that are no function", "a function of the amplitudes")
    count = isinstance(trial.selected, int) and trial.selected >= 0
    require(count, where, f"selected = {trial.selected!r}", "the count of numbers that were fitted before")
    shape = pictures.baseline.shape
    for array in (*trial.templates, *(() if trial.fixed is None else (trial.fixed,))):
        size = np.shape(array)
        require(size == shape, where, f"a change of shape {size}", f"shape {shape}, as the pictures")
        require(bool(np.isfinite(array).all()), where, "a change that is not finite", "finite numbers")


def _require_parameters(values: Any, where: str) -> None:
    """Check parameters as files hold them. Raises InputError for faulty ones."""
    require(values is None or isinstance(values, Mapping), where, f"a {type(values).__name__}", _PARAMETERS)
    for key, value in (values or {}).items():
        require(isinstance(key, str), where, f"a parameter named {key!r}", _PARAMETERS)
        sound = isinstance(value, str | bool | int) or (isinstance(value, float) and np.isfinite(value))
        kind = f"{key} = {value!r}"[:80]
        require(bool(sound), where, f"the parameter {kind}", "finite numbers and text")
