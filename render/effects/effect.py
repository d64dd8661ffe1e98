"""What an effect is: an identifier, its parameters, the stage it acts at, a pure function, how to confirm it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from textwrap import shorten
from typing import Any, Literal

import numpy as np
from cboxlab.scenes.scene import Scene
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import OwnMappings

from ..chain import Stage

__all__ = ["AppliedEffect", "Effect", "Kind", "Parameter", "index_of"]

#: Characters of a title: a list of all effects fits into 80 columns.
_LONGEST_TITLE = 50


#: What a name among a parameter's choices stands for: any that the scene or the capture at hand holds will do.
Kind = Literal["material", "surface", "block", "band"]

#: Below this inverse square a number counts as infinite.
_SMALLEST_INVERSE_SQUARE = 1e-12


@dataclass(frozen=True)
class Parameter:
    """One number, or one name out of ``choices`` (then unit, null and bounds mean nothing).

    null : the value at which the effect does nothing, None for a parameter that has none (a peak's place).
    null_in : how it is read from a scene, where it is the model's own value; ``null`` is then the published box's.
    low, high : bounds of what is physically plausible. default : what a model file that leaves it out means.
    kind : what its names stand for. The choices are then those of the published box; any name of that kind in the
    scene or capture at hand will do. None where the choices are all there are.
    scale : in which coordinate the effect grows evenly with the number, and a fit searches: the number itself, or
    n^-2. step : a small change of that coordinate, for derivatives.
    starts : where a search starts, for a number without null; by default at ``default``, or else half way between
    the bounds. example : the value in the effect's picture; by default four steps from null, or the first choice.
    grows_with_aperture : whether the number is in proportion to the aperture's diameter, as the width of a blur is.
    tolerance : how far the number may be from null without being a finding, one standard deviation: what setting up
    and surveying a box leave, or by what two simulators of one box differ.
    """

    name: str
    unit: str = "1"
    _: KW_ONLY
    null: float | None = None
    null_in: Callable[[Scene], float] | None = None
    low: float = -np.inf
    high: float = np.inf
    step: float = 1e-3
    default: float | None = None
    choices: tuple[str, ...] = ()
    kind: Kind | None = None
    scale: Literal["linear", "inverse square"] = "linear"
    starts: tuple[float, ...] = ()
    example: str | float | None = None
    grows_with_aperture: bool = False
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        """Raises ValueError for fields that contradict each other."""
        if self.null is not None and np.isinf(self.null) and self.scale != "inverse square":
            raise ValueError(f"{self.name}: a null value at infinity needs the scale 'inverse square'")
        if self.kind and not self.choices:
            raise ValueError(f"{self.name}: a parameter of a kind needs choices, those of the published box")

    @property
    def starting_values(self) -> tuple[float, ...]:
        """Where a search starts; one value at least."""
        middle = 0.5 * (self.low + self.high) if self.default is None else self.default
        return self.starts or (middle,)

    def to_coordinate(self, value: float) -> float:
        """The number in the coordinate of ``scale``."""
        return 1 / value**2 if self.scale == "inverse square" else value

    def from_coordinate(self, coordinate: float) -> float:
        """The number of a coordinate, kept within the bounds."""
        if self.scale == "inverse square":
            if coordinate <= _SMALLEST_INVERSE_SQUARE:
                return self.high
            return float(min(coordinate**-0.5, self.high))
        return float(np.clip(coordinate, self.low, self.high))

    @property
    def coordinate_bounds(self) -> tuple[float, float]:
        """Lowest and highest coordinate."""
        if self.scale == "inverse square":
            return self.to_coordinate(self.high), self.to_coordinate(self.low)
        return self.low, self.high

    @property
    def null_coordinate(self) -> float:
        """The coordinate of the null value; 0 where there is none."""
        return 0.0 if self.null is None else self.to_coordinate(self.null)

    @property
    def coordinate_step(self) -> float:
        """A small step of the coordinate, away from null within bounds where there is a null."""
        inside = self.null_coordinate + self.step <= self.coordinate_bounds[1]
        return self.step if inside else -self.step

    def deviation(self, value: float, coordinate_deviation: float) -> float:
        """The standard deviation of the number for one of its coordinate: c = n^-2 gives dn = n^3 / 2 dc."""
        return coordinate_deviation * (0.5 * value**3 if self.scale == "inverse square" else 1.0)


@dataclass(frozen=True)
class Effect:
    """One physical cause that a model may lack.

    stage : where in the chain it acts (``render.chain``). summary : what happens in the real box, with the formula.
    title : the same in a few words, for lists (at most 50 characters); the summary's beginning where it is left out.
    apply : pure function of the stage's value and the parameters by name, to the stage's value. confirm : how a
    laboratory confirms it or rules it out. sources : where the formula is from.
    acts_on_charge : of the counts stage: whether it changes charge, before shot noise arises, or else counts as they
    are read out. spectral_step_nm : of the transport stage: steps of the wavelengths, dividing 300 nm, at which a
    synthetic capture or cube computes its change; the change is linear in between.
    imitates_lamp_power : whether the fit of the lamp's power can do all that the effect does to the picture. Then only
    the lamp's stated uncertainty speaks against the effect. own_to_capture : whether it belongs to one capture and not
    to box or camera, so that another capture of the same box has numbers of its own. file : of which it was read; None
    in the catalogue.
    """

    id: str
    stage: Stage
    summary: str
    parameters: tuple[Parameter, ...]
    apply: Callable[..., Any]
    confirm: str
    _: KW_ONLY
    title: str = ""
    sources: tuple[str, ...] = ()
    acts_on_charge: bool = True
    spectral_step_nm: int = 20
    imitates_lamp_power: bool = False
    own_to_capture: bool = False
    file: Path | None = None

    def __post_init__(self) -> None:
        """Raises ValueError for a title that does not fit into a list."""
        if len(self.title) > _LONGEST_TITLE:
            raise ValueError(f"{self.id}: a title of {len(self.title)} characters, at most {_LONGEST_TITLE} fit")

    @property
    def short_title(self) -> str:
        """The title, or the summary's beginning."""
        return self.title or shorten(self.summary, _LONGEST_TITLE, placeholder="…")

    @property
    def numbers(self) -> tuple[Parameter, ...]:
        """The parameters that are numbers."""
        return tuple(p for p in self.parameters if not p.choices)

    def to_dict(self) -> dict[str, Any]:
        """What the effect is, ready for JSON. A parameter has bounds or choices; its null value may be infinite."""
        return {
            "effect": self.id,
            "stage": self.stage,
            "title": self.short_title,
            "summary": self.summary,
            "parameters": [
                {"name": p.name, "choices": list(p.choices)}
                if p.choices
                else {
                    "name": p.name,
                    "unit": p.unit,
                    "null": p.null,
                    "low": p.low,
                    "high": p.high,
                    "default": p.default,
                }
                for p in self.parameters
            ],
            "confirm": self.confirm,
            "sources": list(self.sources),
        }

    def within(self, scene: Scene) -> Effect:
        """The effect with the null values that it has in a scene."""
        own = [p if p.null_in is None else replace(p, null=p.null_in(scene)) for p in self.parameters]
        return replace(self, parameters=tuple(own))

    @property
    def imitates_nuisance(self) -> bool:
        """Whether the fit of camera or lamp does to the picture what the effect does, or a part of it."""
        return self.imitates_lamp_power or self.stage == "camera"


def index_of(name: str, known: Iterable[str], key: str) -> int:
    """Index of a name among those of scene or capture. Raises InputError (at ``key``) for a name that is not there."""
    names = list(known)
    if name not in names:
        raise InputError(f"effect {key}", f"'{name}', which is not there", f"one of {', '.join(names)}")
    return names.index(name)


@dataclass(frozen=True, eq=False)
class AppliedEffect(OwnMappings):
    """An effect with values for all of its parameters. sigma : standard deviations of those fitted to a capture."""

    effect: Effect
    values: Mapping[str, str | float]
    sigma: Mapping[str, float] = field(default_factory=dict)

    @property
    def id(self) -> str:
        """The effect's identifier."""
        return self.effect.id

    def name_below(self, folder: Path | None) -> str:
        """How files in a folder name the effect: its identifier, or the way to its own file; whole without folder."""
        file = self.effect.file
        if file is None:
            return self.id
        return file.as_posix() if folder is None else Path(os.path.relpath(file, folder.resolve())).as_posix()

    @property
    def stage(self) -> Stage:
        """Where in the chain it acts."""
        return self.effect.stage

    def apply(self, value: Any, *context: Any) -> Any:
        """The stage's value, changed."""
        return self.effect.apply(value, *context, **self.values)

    def at_aperture(self, factor: float) -> AppliedEffect:
        """The effect with the aperture's diameter times a factor."""
        growing = {p.name: factor * float(self.values[p.name]) for p in self.effect.numbers if p.grows_with_aperture}
        return replace(self, values={**self.values, **growing}) if growing else self
