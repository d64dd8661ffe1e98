"""How far a physically based rendering is from photographs of the real box, where, and why.

The stable interface (docs/api.md). Names are loaded when they are first used; ``import cboxlab`` itself loads neither
NumPy nor Mitsuba.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cboxlab.calibration.capture import load_capture
    from cboxlab.render.files import Declared
    from cboxlab.scenes import InputError, load_scene
    from cboxlab.scenes.progress import Cancelled, Progress, Teller
    from cboxlab.validate.model import load_model
    from cboxlab.validate.regress import assert_same_light
    from cboxlab.validate.results import Study, calibrate, diagnose, render, simulate, validate

    __version__: str

__all__ = [
    "Cancelled",
    "Declared",
    "InputError",
    "Progress",
    "Study",
    "Teller",
    "__version__",
    "assert_same_light",
    "calibrate",
    "diagnose",
    "load_capture",
    "load_model",
    "load_scene",
    "render",
    "simulate",
    "validate",
]

#: The package that each name comes from.
_HOMES = {
    "Cancelled": "scenes.progress",
    "Declared": "render.files",
    "InputError": "scenes",
    "Progress": "scenes.progress",
    "Study": "validate.results",
    "Teller": "scenes.progress",
    "assert_same_light": "validate.regress",
    "calibrate": "validate.results",
    "diagnose": "validate.results",
    "load_capture": "calibration.capture",
    "load_model": "validate.model",
    "load_scene": "scenes",
    "render": "validate.results",
    "simulate": "validate.results",
    "validate": "validate.results",
}

#: Names of a function that are names of a room, too.
_ROOMS = ("render", "validate")

# In a checkout the rooms lie beside this folder, in an installation inside it.
if not (Path(__file__).parent / "scenes").is_dir():
    __path__.append(str(Path(__file__).parents[1]))


class _RoomAndFunction(ModuleType):
    """A room that is called like the function of its name: ``cboxlab.validate(...)``."""

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        name = self.__name__.removeprefix("cboxlab.")
        return getattr(import_module(f"cboxlab.{_HOMES[name]}"), name)(*arguments, **keywords)


class _Face(ModuleType):
    """Python sets a room as an attribute of its package when it is first imported, from wherever that is.

    So ``cboxlab.validate`` is the room, and must be the function, too: it is made callable at that moment.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if name in _ROOMS and isinstance(value, ModuleType):
            value.__class__ = _RoomAndFunction
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Face


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("cboxlab")
    if name in _ROOMS:
        return import_module(f"cboxlab.{name}")
    if name in _HOMES:
        return getattr(import_module(f"cboxlab.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'cboxlab' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
