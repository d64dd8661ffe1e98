"""What a user declares of a file that does not state it: units, scale, wavelengths, colour space."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from .cube_checks import RADIANCE_UNIT

__all__ = [
    "AS_STATED",
    "DECLARABLE",
    "NOTES",
    "Declared",
    "DeclaredPair",
    "declared_for",
    "photometric_factor",
    "require_used",
    "scaled",
    "sorted_planes",
    "spectral_factor",
    "stated_in",
    "told",
    "with_notes",
]

#: Attribute of a dataset that was read: what the reader of the file has to know, one note a line.
NOTES = "reading_notes"
_USED, _STATED = "declared_used", "declared_otherwise"

#: Size and powers of watt, metre, steradian and candela.
_UNITS = {
    "W": (1.0, (1, 0, 0, 0)),
    "mW": (1e-3, (1, 0, 0, 0)),
    "uW": (1e-6, (1, 0, 0, 0)),
    "kW": (1e3, (1, 0, 0, 0)),
    "m": (1.0, (0, 1, 0, 0)),
    "cm": (1e-2, (0, 1, 0, 0)),
    "mm": (1e-3, (0, 1, 0, 0)),
    "um": (1e-6, (0, 1, 0, 0)),
    "nm": (1e-9, (0, 1, 0, 0)),
    "sr": (1.0, (0, 0, 1, 0)),
    "cd": (1.0, (0, 0, 0, 1)),
    "kcd": (1e3, (0, 0, 0, 1)),
    "lm": (1.0, (0, 0, 1, 1)),
    "nit": (1.0, (0, -2, 0, 1)),
}
_FACTOR = re.compile(r"(/?)\s*([A-Za-z]+)\s*(?:\^|\*\*)?\s*\(?([+-]?\d)?\)?")
_POWERS = str.maketrans("⁰¹²³⁻µμ", "0123-uu")
PHOTOMETRIC_UNIT = "cd m^-2"


@dataclass(frozen=True)
class Declared:
    """Each applies to files that do not state it, and to no other; it may repeat what a file states.

    units : of the stored values times ``scale``. wavelengths_nm : of the planes, in the order of the file.
    colour_space : of R, G and B, see ``colour_pictures``.
    """

    units: str | None = None
    scale: float | None = None
    wavelengths_nm: tuple[float, ...] | None = None
    colour_space: str | None = None

    def given(self) -> set[str]:
        """Names of what is declared."""
        return {name for name, value in vars(self).items() if value is not None}


AS_STATED = Declared()

#: Fields of Declared by their key in messages.
DECLARABLE = {
    "units": "units",
    "scale": "scale",
    "wavelengths": "wavelengths_nm",
    "colour-space": "colour_space",
}
_KEYS = {name: key for key, name in DECLARABLE.items()}


@dataclass(frozen=True)
class DeclaredPair:
    """Of two files that are compared. names : of the two, in messages. both : for either; own : for one alone, in place
    of ``both``.
    """

    names: tuple[str, str]
    both: Declared = AS_STATED
    own: tuple[Declared, Declared] = (AS_STATED, AS_STATED)

    def of(self, index: int) -> Declared:
        """For the first (0) or the second (1)."""
        own = self.own[index]
        return replace(self.both, **{name: getattr(own, name) for name in own.given()})

    def require_used(
        self, used: tuple[Iterable[str], Iterable[str]], stated: tuple[Mapping[str, str], Mapping[str, str]]
    ) -> None:
        """As ``require_used``, each declaration by the files that it is for. used, stated : of each file."""
        require_used(self.both, [*used[0], *used[1]], {**stated[1], **stated[0]})
        for name, own, applied, found in zip(self.names, self.own, used, stated, strict=True):
            require_used(own, applied, found, f"{name}:")


def _parsed(unit: object) -> tuple[float, tuple[int, ...]] | None:
    """Size in SI units, and powers of watt, metre, steradian, candela; None for what is no such unit."""
    text = str(unit).translate(_POWERS).replace("·", " ").replace("*", " ").replace(".", " ").strip()
    # one division by a bracket: W/(m^2 sr nm)
    if match := re.fullmatch(r"([^/()]+)/\s*\(([^()/]+)\)", text):
        text = match[1] + " /" + " /".join(match[2].split())
    if _FACTOR.sub("", text).strip():
        return None
    size, powers = 1.0, np.zeros(4, int)
    for over, name, power in _FACTOR.findall(text):
        if name not in _UNITS:
            return None
        exponent = int(power or 1) * (-1 if over else 1)
        own, dimensions = _UNITS[name]
        size, powers = size * own**exponent, powers + exponent * np.array(dimensions)
    return size, tuple(map(int, powers))


def _factor(where: str | Path, stated: str | None, declared: Declared, unit: str, hint: str) -> float:
    scale = 1.0
    if stated is None:
        if declared.units is None:
            found = "no unit"
            how = f"declare units='{unit}', and scale=FACTOR to it. {hint}"
            raise InputError(where, found, f"the unit of its values, such as '{unit}'", how.strip())
        where, stated, scale = "declared units", declared.units, declared.scale or 1.0
    found_unit, wanted = _parsed(stated), _parsed(unit)
    if found_unit is None or wanted is None or found_unit[1] != wanted[1]:
        raise InputError(where, f"the unit '{stated}'", f"'{unit}' or a multiple of it", "Convert it first.")
    return scale * found_unit[0] / wanted[0]


def spectral_factor(where: str | Path, stated: str | None, declared: Declared, hint: str = "") -> float:
    """Factor from stored values to W m^-2 sr^-1 nm^-1. stated : the file's own unit, None where it has none.

    Raises InputError where neither the file nor the user names a unit, and for other units than of spectral radiance.
    """
    return _factor(where, stated, declared, RADIANCE_UNIT, hint)


def photometric_factor(where: str | Path, stated: str | None, declared: Declared, hint: str = "") -> float:
    """Factor from stored X, Y, Z to cd m^-2. As ``spectral_factor``."""
    return _factor(where, stated, declared, PHOTOMETRIC_UNIT, hint)


def with_notes(dataset: xr.Dataset, notes: Iterable[str]) -> xr.Dataset:
    """The dataset with further notes."""
    lines = [*filter(None, str(dataset.attrs.get(NOTES, "")).split("\n")), *notes]
    return dataset.assign_attrs({NOTES: "\n".join(lines)}) if lines else dataset


def told(
    dataset: xr.Dataset,
    declared: Declared,
    used: Iterable[str] = (),
    notes: Iterable[str] = (),
    stated: Mapping[str, object] | None = None,
) -> xr.Dataset:
    """The dataset with notes, and a note of what was declared for it. used : names of fields of Declared.

    stated : what the file says itself of others, by name; wavelengths are taken from the dataset. A unit comes with a
    scale of 1 where none is given.
    """
    names = [name for name in used if getattr(declared, name) is not None]
    own = [f"{_KEYS[n]} as declared: {_shown(getattr(declared, n))}" for n in names]
    noted = with_notes(dataset, [*notes, *own])
    known = dict(stated or {})
    if "wavelength" in dataset.coords:
        known["wavelengths_nm"] = tuple(map(float, np.atleast_1d(dataset["wavelength"].values)))
    if "units" in known:
        known.setdefault("scale", 1.0)
    others = {name: known[name] for name in declared.given() & set(known) - set(used)}
    agreeing = [name for name, value in others.items() if _agrees(name, getattr(declared, name), value)]
    if names or agreeing:
        noted = noted.assign_attrs({_USED: ",".join([*names, *agreeing])})
    differing = {name: _shown(value) for name, value in others.items() if name not in agreeing}
    return noted.assign_attrs({_STATED: json.dumps(differing)}) if differing else noted


def _agrees(name: str, declared: object, stated: object) -> bool:
    """Whether a declaration says what the file says, within the digits that files are written with."""
    if name == "units":
        one, other = _parsed(declared), _parsed(stated)
        if one is None or other is None:
            return False
        return one[1] == other[1] and bool(np.isclose(one[0], other[0], rtol=1e-9))
    if name == "colour_space":
        return declared == stated
    one_nm, other_nm = np.sort(np.atleast_1d(declared)), np.sort(np.atleast_1d(stated))  # type: ignore[call-overload]
    return one_nm.shape == other_nm.shape and bool(np.allclose(one_nm, other_nm, rtol=1e-6, atol=0))


def _shown(value: object) -> str:
    if isinstance(value, tuple):
        return f"{len(value)} from {min(value):g} to {max(value):g} nm"
    return str(value)


def declared_for(dataset: xr.Dataset) -> tuple[str, ...]:
    """Which fields of Declared were used when the dataset was read, or say what its file says."""
    return tuple(filter(None, str(dataset.attrs.get(_USED, "")).split(",")))


def stated_in(dataset: xr.Dataset) -> dict[str, str]:
    """By field of Declared, what the file states in place of what was declared."""
    return dict(json.loads(str(dataset.attrs.get(_STATED, "{}"))))


def require_used(
    declared: Declared, used: Iterable[str], stated: Mapping[str, str] | None = None, which: str = ""
) -> None:
    """Raise InputError for what is declared although every file states another value, or has no such thing.

    used : by any of the files. stated : see ``stated_in``. which : in front of the key in the message.
    """
    found = stated or {}
    for name in sorted(declared.given() - set(used)):
        instead = f"{found[name]}, or none: the file states it itself" if name in found else "none: no file needs it"
        raise InputError(f"declared {which}{_KEYS[name]}", _shown(getattr(declared, name)), instead)


def scaled(values: NDArray, factor: float) -> NDArray:
    """Values times a factor, of their own type; the same array where the factor is 1."""
    return values if factor == 1 else (values * np.float64(factor)).astype(np.result_type(values.dtype, np.float32))


def sorted_planes(
    path: Path, planes: NDArray, wavelength_nm: NDArray[np.float64]
) -> tuple[NDArray, NDArray[np.float64]]:
    """Planes (..., w) and wavelengths, ascending. Raises InputError for a wavelength twice."""
    order = np.argsort(wavelength_nm, kind="stable")
    ascending = np.asarray(wavelength_nm, float)[order]
    twice = np.flatnonzero(np.diff(ascending) == 0)
    if twice.size:
        raise InputError(f"{path}: wavelength", f"{ascending[twice[0]]:g} nm twice", "each wavelength once")
    if np.array_equal(order, np.arange(order.size)):
        return planes, ascending
    return planes[..., order], ascending
