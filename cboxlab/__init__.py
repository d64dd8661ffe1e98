"""Validation of physically based rendering against photographs of a real Cornell Box.

A capture is compared with the rendering of a model, and the difference is explained by physical causes. This is the
stable interface, described in docs/api.md. Names are loaded when they are first used; ``import cboxlab`` itself loads
neither NumPy nor Mitsuba.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

from .utils.lazy import lazy_names

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

logging.getLogger(__name__).addHandler(logging.NullHandler())

_load, __dir__ = lazy_names(__name__)


def __getattr__(name: str) -> Any:
    """Name of the interface, loaded when it is first used."""
    if name == "__version__":
        from importlib.metadata import version

        return version("cboxlab")
    return _load(name)
