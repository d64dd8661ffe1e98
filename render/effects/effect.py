"""Effects and their parameters.

An effect is one physical cause. It acts at one stage of the chain, by a pure function of that stage's value.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from textwrap import shorten
from typing import Any, Literal

import numpy as np
from cboxlab.scenes.scene import Scene
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings

from ..chain import Stage

__all__ = ["AppliedEffect", "Effect", "Kind", "Parameter", "index_of"]

#: Longest title, characters: with the stage and the identifier before it, a line of a list fits into 80 columns.
_LONGEST_TITLE = 50

#: Meaning of the names among a parameter's choices: any such name of the scene or capture is allowed.
Kind = Literal["material", "surface", "block", "band"]

#: Endings by which parameters' names state units, where they are not the unit in small letters.
_UNITS_IN_NAMES: Mapping[str, str] = {
    "px per 100 nm": "px_per_100nm",
    "m^-1": "per_m",
    "min^-1": "per_minute",
    "s": "seconds",
    "1e-6 nm^-1": "ppm_per_nm",
}

#: Label of a number whose name is its unit alone.
_SIZE = "size"

#: Signs of exponents in print.
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

#: Inverse square below which a number counts as infinite, for numbers of order 1: 1e-12 is a number of a million.
_SMALLEST_INVERSE_SQUARE = 1e-12


@dataclass(frozen=True)
class Parameter:
    """Parameter of an effect: a number with unit and bounds, or a name out of ``choices``.

    A name has no unit, null value or bounds. A fit does not search in the number itself but in a coordinate in which
    the effect grows evenly: c = n, or c = n^-2 for ``scale`` "inverse square".

    Raises
    ------
    ValueError
        If a null value at infinity has the linear scale, or a kind has no choices.

    Examples
    --------
    >>> from cboxlab.rendering.effects import Parameter
    >>> index = Parameter("effective_index", null=float("inf"), low=1.05, scale="inverse square")
    >>> index.to_coordinate(2.0), index.from_coordinate(0.25)
    (0.25, 2.0)
    """

    #: Name by which model files and the effect's function give it.
    name: str
    #: Unit of the number; "1" for none.
    unit: str = "1"
    _: KW_ONLY
    #: Value at which the effect does nothing; None for a number without one, such as the wavelength of a peak.
    null: float | None = None
    #: Function that reads the null value from a scene; ``null`` is then that of the published box. None if it is fixed.
    null_in: Callable[[Scene], float] | None = None
    #: Lowest physically plausible value.
    low: float = -np.inf
    #: Highest physically plausible value.
    high: float = np.inf
    #: Step of the coordinate for derivatives; it changes the rendering by a fraction of its noise.
    step: float = 1e-3
    #: Value where a model file gives none; None for the null value.
    default: float | None = None
    #: Names that may be given; empty for a number.
    choices: tuple[str, ...] = ()
    #: Meaning of the names; ``choices`` are then those of the published box. None if the choices are complete.
    kind: Kind | None = None
    #: Coordinate of a fit, the number itself ("linear") or its inverse square.
    scale: Literal["linear", "inverse square"] = "linear"
    #: Values at which a search starts, for a number without null value; empty for ``default`` or the bounds' middle.
    starts: tuple[float, ...] = ()
    #: Value in the effect's picture of the manual; None for four steps from null, or the first choice.
    example: str | float | None = None
    #: Whether the number is in proportion to the aperture's diameter, as the width of a blur is.
    grows_with_aperture: bool = False
    #: Standard deviation from null that is no finding, as a survey or a second simulator leaves it.
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        """Check that the fields agree."""
        if self.null is not None and np.isinf(self.null) and self.scale != "inverse square":
            raise ValueError(f"{self.name}: a null value at infinity needs the scale 'inverse square'")
        if self.kind and not self.choices:
            raise ValueError(f"{self.name}: a parameter of a kind needs choices, those of the published box")

    @property
    def label(self) -> str:
        """Name in words without its unit, for reports and pages.

        Examples
        --------
        >>> Parameter("extinction_per_m", "m^-1").label
        'extinction'
        """
        ending = _UNITS_IN_NAMES.get(self.unit, self.unit.lower())
        return _SIZE if self.name == ending else self.name.removesuffix(f"_{ending}").replace("_", " ")

    @property
    def printed_unit(self) -> str:
        """Unit with raised exponents, for reports and pages; empty for none."""
        if self.unit == "1":
            return ""
        powers = re.sub(r"\b1e(-?\d+)", r"× 10^\1", "°" if self.unit == "deg" else self.unit)
        return re.sub(r"\^(-?\d+)", lambda power: power[1].translate(_RAISED), powers)

    @property
    def starting_values(self) -> tuple[float, ...]:
        """Values at which a search starts; at least one."""
        middle = 0.5 * (self.low + self.high) if self.default is None else self.default
        return self.starts or (middle,)

    def to_coordinate(self, value: float) -> float:
        """Coordinate of a value.

        Parameters
        ----------
        value
            The number, in ``unit``; not 0 for "inverse square".

        Returns
        -------
        float
            n, or n^-2; 0 for an infinite number on the inverse square.
        """
        return 1 / value**2 if self.scale == "inverse square" else value

    def from_coordinate(self, coordinate: float) -> float:
        """Value of a coordinate.

        Parameters
        ----------
        coordinate
            The coordinate; it may lie outside the bounds.

        Returns
        -------
        float
            The number, in ``unit``. A linear one is clipped to the bounds, an inverse square one to ``high`` only.
        """
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
        """Coordinate of the null value; 0 if there is no null value."""
        return 0.0 if self.null is None else self.to_coordinate(self.null)

    @property
    def coordinate_step(self) -> float:
        """Step of the coordinate from null; negative if a positive step would leave the bounds."""
        inside = self.null_coordinate + self.step <= self.coordinate_bounds[1]
        return self.step if inside else -self.step

    def deviation(self, value: float, coordinate_deviation: float) -> float:
        """Standard deviation of the number from that of its coordinate.

        For c = n^-2 it is n^3 / 2 times that of the coordinate, to first order.

        Parameters
        ----------
        value
            The number, in ``unit``.
        coordinate_deviation
            Standard deviation of the coordinate.

        Returns
        -------
        float
            Standard deviation, in ``unit``.
        """
        return coordinate_deviation * (0.5 * value**3 if self.scale == "inverse square" else 1.0)


@dataclass(frozen=True)
class Effect:
    """One physical cause that a model may lack.

    The same object simulates the effect, predicts it, fits it and describes it to users.

    Raises
    ------
    ValueError
        If the title has more than 50 characters.
    """

    #: Identifier in model files and reports, of small letters, digits and hyphens.
    id: str
    #: Stage of the chain at which it acts, see ``cboxlab.rendering.chain``.
    stage: Stage
    #: Description for users of the cause in the real box, with the formula.
    summary: str
    #: Parameters in the order of lists and fits.
    parameters: tuple[Parameter, ...]
    #: Pure function of the stage's value, and of the parameters by name, to the changed value.
    apply: Callable[..., Any]
    #: Description of the measurement by which a laboratory confirms the effect or rules it out.
    confirm: str
    _: KW_ONLY
    #: Description for lists, at most 50 characters; empty for the beginning of the summary.
    title: str = ""
    #: Format string of a sentence's part on its size, with the parameters by name; empty for none.
    in_words: str = ""
    #: Publications and standards of the formula.
    sources: tuple[str, ...] = ()
    #: Whether an effect on counts changes charge, before shot noise arises, or counts as they are read out.
    acts_on_charge: bool = True
    #: Step, nm, of the wavelengths at which the change of the transport is computed; it divides 300. Linear in between.
    spectral_step_nm: int = 20
    #: Whether a fit of the lamp's power can do the same. Only the lamp's stated uncertainty then speaks against it.
    imitates_lamp_power: bool = False
    #: Whether it is a coat, whose mirrored light is separate from the light of the paint below.
    is_coat: bool = False
    #: Whether it belongs to one capture, so that another capture of the same box has other values.
    own_to_capture: bool = False
    #: Effect file that it was read from; None in the catalogue.
    file: Path | None = None

    def __post_init__(self) -> None:
        """Check that the title fits into a list."""
        if len(self.title) > _LONGEST_TITLE:
            raise ValueError(f"{self.id}: a title of {len(self.title)} characters, at most {_LONGEST_TITLE} fit")

    @property
    def short_title(self) -> str:
        """Title, or the beginning of the summary, at most 50 characters."""
        return self.title or shorten(self.summary, _LONGEST_TITLE, placeholder="…")

    @property
    def numbers(self) -> tuple[Parameter, ...]:
        """Parameters that are numbers."""
        return tuple(p for p in self.parameters if not p.choices)

    @property
    def acts_on_things(self) -> bool:
        """Whether a parameter of it names a paint, a surface or a block."""
        return any(p.kind in ("material", "surface", "block") for p in self.parameters)

    def to_dict(self) -> dict[str, Any]:
        """Description of the effect, ready for JSON.

        Returns
        -------
        dict
            Identifier, stage, title, summary, parameters, confirm, sources. A parameter has bounds or choices; its
            null value may be infinite.
        """
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
        """Effect with the null values that it has in a scene.

        Parameters
        ----------
        scene
            The scene of the model.

        Returns
        -------
        Effect
            A copy in which every parameter with ``null_in`` has the null value of the scene.
        """
        parameters = [p if p.null_in is None else replace(p, null=p.null_in(scene)) for p in self.parameters]
        return replace(self, parameters=tuple(parameters))

    @property
    def imitates_nuisance(self) -> bool:
        """Whether the fit of camera or lamp can do the same to the rendering, or a part of it."""
        return self.imitates_lamp_power or self.stage == "camera"


def index_of(name: str, names: Iterable[str], where: str) -> int:
    """Index of a name among the names of a scene or capture.

    Parameters
    ----------
    name
        The name that an effect's parameter gives.
    names
        Names of the scene or capture, in order.
    where
        Effect and parameter for the error, such as "gloss: material".

    Returns
    -------
    int
        Position of the name, from 0.

    Raises
    ------
    InputError
        If the name is not among them.
    """
    allowed = list(names)
    if name not in allowed:
        raise InputError(f"effect {where}", f"'{name}', which is not there", f"one of {', '.join(allowed)}")
    return allowed.index(name)


@dataclass(frozen=True, eq=False)
class AppliedEffect(FrozenMappings):
    """Effect with values for all of its parameters."""

    #: The effect.
    effect: Effect
    #: Value of every parameter by name, numbers in the parameter's unit.
    values: Mapping[str, str | float]
    #: Standard deviations by name, of the numbers that were fitted to a capture.
    sigma: Mapping[str, float] = field(default_factory=dict)

    @property
    def id(self) -> str:
        """Identifier of the effect."""
        return self.effect.id

    def name_below(self, folder: Path | None) -> str:
        """Name of the effect in the files of a folder.

        Parameters
        ----------
        folder
            The folder; None for absolute paths.

        Returns
        -------
        str
            The identifier, or the path of the effect file relative to ``folder``, with forward slashes.
        """
        file = self.effect.file
        if file is None:
            return self.id
        return file.as_posix() if folder is None else Path(os.path.relpath(file, folder.resolve())).as_posix()

    @property
    def stage(self) -> Stage:
        """Stage of the chain at which the effect acts."""
        return self.effect.stage

    def apply(self, value: Any, *context: Any) -> Any:
        """Value of the stage after the effect.

        Parameters
        ----------
        value
            Value of the stage before it; it stays unchanged.
        *context
            Further arguments of the stage's functions, if it has any.

        Returns
        -------
        Any
            The changed value, of the same type.
        """
        return self.effect.apply(value, *context, **self.values)

    def at_aperture(self, factor: float) -> AppliedEffect:
        """Effect at another aperture.

        Parameters
        ----------
        factor
            Diameter of the aperture, relative to that of the values.

        Returns
        -------
        AppliedEffect
            A copy with the numbers that grow with the aperture scaled; the same object if there are none.
        """
        growing = {p.name: factor * float(self.values[p.name]) for p in self.effect.numbers if p.grows_with_aperture}
        return replace(self, values={**self.values, **growing}) if growing else self
