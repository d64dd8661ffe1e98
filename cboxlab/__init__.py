"""Validation of physically based rendering against photographs of a real Cornell Box.

A capture is compared with the rendering of a model, and the difference is explained by physical causes. This is the
stable interface, described in docs/api.md. Names are loaded when they are first used; ``import cboxlab`` itself loads
neither NumPy nor Mitsuba.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cboxlab.calibration.capture import load_capture
    from cboxlab.rendering.files import Declared
    from cboxlab.rendering.model import load_model
    from cboxlab.scenes import load_scene
    from cboxlab.utils.errors import InputError
    from cboxlab.utils.progress import Cancelled, Progress, ProgressReporter
    from cboxlab.validation.api import Study, calibrate, diagnose, render, simulate, validate
    from cboxlab.validation.compare_renders.regress import assert_same_light
    from cboxlab.validation.dataset import Dataset, create_dataset, open_dataset

    __version__: str

__all__ = [
    "Cancelled",
    "Dataset",
    "Declared",
    "InputError",
    "Progress",
    "ProgressReporter",
    "Study",
    "__version__",
    "assert_same_light",
    "calibrate",
    "create_dataset",
    "diagnose",
    "load_capture",
    "load_model",
    "load_scene",
    "open_dataset",
    "render",
    "simulate",
    "validate",
]

#: Package of each name, below ``cboxlab``.
_HOMES = {
    "Cancelled": "utils.progress",
    "Dataset": "validation.dataset",
    "Declared": "rendering.files",
    "InputError": "scenes",
    "Progress": "utils.progress",
    "ProgressReporter": "utils.progress",
    "Study": "validation.api",
    "assert_same_light": "validation.compare_renders.regress",
    "calibrate": "validation.api",
    "create_dataset": "validation.dataset",
    "diagnose": "validation.api",
    "load_capture": "calibration.capture",
    "load_model": "rendering.model",
    "load_scene": "scenes",
    "open_dataset": "validation.dataset",
    "render": "validation.api",
    "simulate": "validation.api",
    "validate": "validation.api",
}


def __getattr__(name: str) -> Any:
    """Load a name of the interface when it is first used (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import version

        return version("cboxlab")
    if name in _HOMES:
        return getattr(import_module(f"cboxlab.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'cboxlab' has no attribute '{name}'")


def __dir__() -> list[str]:
    """Names of the module, including those not loaded yet."""
    return sorted({*globals(), *__all__})
