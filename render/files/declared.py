"""User's declarations for files that do not state units, scale, wavelengths or colour space."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.utils.arguments import described, require_type, required_number
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from .cube_checks import RADIANCE_UNIT
from .headers import same_unit

__all__ = [
    "AS_STATED",
    "DECLARABLE",
    "NOTES",
    "UNIT_AS_STORED",
    "Declared",
    "DeclaredPair",
    "declared_for",
    "photometric_factor",
    "require_used",
    "scaled",
    "sorted_planes",
    "spectral_factor",
    "stated_in",
    "with_declarations",
    "with_notes",
]

#: Attribute of a dataset that was read: notes for its reader, one a line.
NOTES = "reading_notes"

#: Attribute: fields of Declared that were used, or agree with the file, separated by commas.
_USED = "declared_used"

#: Attribute: what the file states in place of what was declared, by field, in JSON.
_STATED = "declared_otherwise"

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

#: One factor of a unit: a slash in front, a name, a power.
_FACTOR = re.compile(r"(/?)\s*([A-Za-z]+)\s*(?:\^|\*\*)?\s*\(?([+-]?\d)?\)?")

#: Raised digits and micro signs as plain ones.
_POWERS = str.maketrans("⁰¹²³⁻µμ", "0123-uu")

#: In place of a declared unit: numbers of a file that states none, as they are.
UNIT_AS_STORED = "as stored"

#: Unit of X, Y, Z.
PHOTOMETRIC_UNIT = "cd m^-2"


@dataclass(frozen=True)
class Declared:
    """Properties of files that a user declares.

    Each applies to files that do not state it, and to no other; it may repeat what a file states.
    """

    #: Unit of the stored values times ``scale``; None if not declared.
    units: str | None = None
    #: Factor from the stored values to ``units``; None if not declared.
    scale: float | None = None
    #: Wavelengths of the planes in the order of the file, nm; None if not declared.
    wavelengths_nm: tuple[float, ...] | None = None
    #: Colour space of R, G and B, see ``colour_pictures``; None if not declared.
    colour_space: str | None = None
    #: Unit of a list of wavelengths that the file has without one; None if not declared.
    wavelength_unit: str | None = None
    #: Layer of channels R, G, B that is the picture, where a file holds several; None if not declared.
    layer: str | None = None

    def __post_init__(self) -> None:
        for key in ("units", "colour-space", "wavelength-unit", "layer"):
            value = getattr(self, DECLARABLE[key])
            if value is not None and (not isinstance(value, str) or not value):
                raise InputError(f"declared {key}", described(value), "a text")
        if self.scale is not None:
            required_number("declared scale", self.scale, above=0.0)
        if self.wavelengths_nm is not None:
            require_type("declared wavelengths", self.wavelengths_nm, (tuple, list), "a tuple of wavelengths, nm")
            for wavelength in self.wavelengths_nm:
                required_number("declared wavelengths", wavelength, above=0.0)

    def declared_fields(self) -> set[str]:
        """Names of the fields that are declared.

        Returns
        -------
        set of str
            Fields that are not None.
        """
        return {name for name, value in vars(self).items() if value is not None}


#: Fields of Declared by their key in messages.
DECLARABLE = {
    "units": "units",
    "scale": "scale",
    "wavelengths": "wavelengths_nm",
    "wavelength-unit": "wavelength_unit",
    "colour-space": "colour_space",
    "layer": "layer",
}
_KEYS = {name: key for key, name in DECLARABLE.items()}

#: No declaration.
AS_STATED = Declared()


@dataclass(frozen=True)
class DeclaredPair:
    """Declarations for two files that are compared."""

    #: Names of the two in messages.
    names: tuple[str, str]
    #: Declarations for either file.
    both: Declared = AS_STATED
    #: Declarations for the first and for the second alone, in place of ``both``.
    by_file: tuple[Declared, Declared] = (AS_STATED, AS_STATED)

    def of(self, index: int) -> Declared:
        """Declarations for one of the two.

        Parameters
        ----------
        index
            0 for the first, 1 for the second.

        Returns
        -------
        Declared
            Declarations for this file, completed by those for both files.
        """
        single = self.by_file[index]
        return replace(self.both, **{name: getattr(single, name) for name in single.declared_fields()})

    def require_used(
        self, used: tuple[Iterable[str], Iterable[str]], file_values: tuple[Mapping[str, str], Mapping[str, str]]
    ) -> None:
        """Check each declaration by the files that it is for, as the function ``require_used``.

        Parameters
        ----------
        used
            By file, the fields that were used or agree (``declared_for``).
        file_values
            By file, the values that differ from the declared ones (``stated_in``).

        Raises
        ------
        InputError
            If a file states another value than declared, or no file needs a declaration.
        """
        require_used(self.both, [*used[0], *used[1]], {**file_values[1], **file_values[0]})
        for name, single, applied, otherwise in zip(self.names, self.by_file, used, file_values, strict=True):
            require_used(single, applied, otherwise, f"{name}:")


def _parsed(unit: object) -> tuple[float, tuple[int, ...]] | None:
    """Size in SI units, and powers of watt, metre, steradian, candela; None for other units."""
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
        unit_size, dimensions = _UNITS[name]
        size, powers = size * unit_size**exponent, powers + exponent * np.array(dimensions)
    return size, tuple(map(int, powers))


def _factor(where: str | Path, file_unit: str | None, declared: Declared, unit: str, hint: str) -> float:
    """Factor from stored values to ``unit``, see ``spectral_factor``."""
    scale = 1.0
    if file_unit is None:
        if declared.units is None:
            how = f"declare units='{unit}', and scale=FACTOR to it. {hint}"
            raise InputError(where, "no unit", f"the unit of its values, such as '{unit}'", how.strip())
        if declared.units == UNIT_AS_STORED:
            return declared.scale or 1.0
        where, file_unit, scale = "declared units", declared.units, declared.scale or 1.0
    stored, target = _parsed(file_unit), _parsed(unit)
    if stored is None or target is None or stored[1] != target[1]:
        raise InputError(where, f"the unit '{file_unit}'", f"'{unit}' or a multiple of it", "Convert it first.")
    return scale * stored[0] / target[0]


def spectral_factor(where: str | Path, file_unit: str | None, declared: Declared, hint: str = "") -> float:
    """Factor from stored values to W m^-2 sr^-1 nm^-1.

    Parameters
    ----------
    where
        File and key, for the message.
    file_unit
        Unit that the file states; None where it states none.
    declared
        Unit and scale for a file that states none.
    hint
        Further advice where both lack the unit.

    Returns
    -------
    float
        The factor, the declared scale included.

    Raises
    ------
    InputError
        If neither the file nor the user names a unit, or it is none of spectral radiance.
    """
    return _factor(where, file_unit, declared, RADIANCE_UNIT, hint)


def photometric_factor(where: str | Path, file_unit: str | None, declared: Declared, hint: str = "") -> float:
    """Factor from stored X, Y, Z to cd m^-2.

    Parameters
    ----------
    where, file_unit, declared, hint
        As ``spectral_factor``.

    Returns
    -------
    float
        The factor, the declared scale included.

    Raises
    ------
    InputError
        If neither the file nor the user names a unit, or it is none of luminance.
    """
    return _factor(where, file_unit, declared, PHOTOMETRIC_UNIT, hint)


def with_notes(dataset: xr.Dataset, notes: Iterable[str]) -> xr.Dataset:
    """Dataset with further notes for its reader.

    Parameters
    ----------
    dataset
        Dataset of a file.
    notes
        Notes of one line each.

    Returns
    -------
    xr.Dataset
        The same arrays, with the attribute NOTES where there are any.
    """
    lines = [*filter(None, str(dataset.attrs.get(NOTES, "")).split("\n")), *notes]
    return dataset.assign_attrs({NOTES: "\n".join(lines)}) if lines else dataset


def with_declarations(
    dataset: xr.Dataset,
    declared: Declared,
    used: Iterable[str] = (),
    notes: Iterable[str] = (),
    file_values: Mapping[str, object] | None = None,
) -> xr.Dataset:
    """Dataset with notes, and with a record of the declarations used for it.

    Parameters
    ----------
    dataset
        Dataset of a file.
    declared
        All declarations for the file.
    used
        Fields of ``declared`` that the file needed.
    notes
        Further notes for the reader.
    file_values
        Values that the file states of other fields. Wavelengths are taken from the dataset; a unit comes with a scale
        of 1 where none is stated.

    Returns
    -------
    xr.Dataset
        The same arrays; ``declared_for`` and ``stated_in`` read the record.
    """
    used = tuple(used)
    names = [name for name in used if getattr(declared, name) is not None]
    values = {n: _value_text(getattr(declared, n)) for n in names}
    applied = [f"{_KEYS[n]} as declared: {value}" for n, value in values.items() if value != UNIT_AS_STORED]
    noted = with_notes(dataset, [*notes, *applied])
    of_file = dict(file_values or {})
    if "wavelength" in dataset.coords:
        of_file["wavelengths_nm"] = tuple(map(float, np.atleast_1d(dataset["wavelength"].values)))
    if "units" in of_file:
        of_file.setdefault("scale", 1.0)
    others = {name: of_file[name] for name in declared.declared_fields() & set(of_file) - set(used)}
    agreeing = [name for name, value in others.items() if _agrees(name, getattr(declared, name), value)]
    if names or agreeing:
        noted = noted.assign_attrs({_USED: ",".join([*names, *agreeing])})
    differing = {name: _value_text(value) for name, value in others.items() if name not in agreeing}
    return noted.assign_attrs({_STATED: json.dumps(differing)}) if differing else noted


def _agrees(name: str, declared: object, file_values: object) -> bool:
    """Whether a declaration says the same as the file, within the digits of files."""
    if name == "units":
        first, second = _parsed(declared), _parsed(file_values)
        if first is None or second is None:
            return False
        return first[1] == second[1] and bool(np.isclose(first[0], second[0], rtol=1e-9))
    if name == "wavelength_unit":
        return same_unit(declared, file_values)
    if name in ("colour_space", "layer"):
        return declared == file_values
    first_nm, second_nm = np.sort(np.atleast_1d(declared)), np.sort(np.atleast_1d(file_values))  # type: ignore[call-overload]
    return first_nm.shape == second_nm.shape and bool(np.allclose(first_nm, second_nm, rtol=1e-6, atol=0))


def _value_text(value: object) -> str:
    """A declared value in a message; of wavelengths their number and range."""
    if isinstance(value, tuple):
        return f"{len(value)} from {min(value):g} to {max(value):g} nm"
    return str(value)


def declared_for(dataset: xr.Dataset) -> tuple[str, ...]:
    """Fields of Declared that were used for a dataset, or agree with its file.

    Parameters
    ----------
    dataset
        Dataset of a file.

    Returns
    -------
    tuple of str
        Names of the fields.
    """
    return tuple(filter(None, str(dataset.attrs.get(_USED, "")).split(",")))


def stated_in(dataset: xr.Dataset) -> dict[str, str]:
    """Values that the file of a dataset states in place of what was declared.

    Parameters
    ----------
    dataset
        Dataset of a file.

    Returns
    -------
    dict
        The file's value by field of Declared.
    """
    return dict(json.loads(str(dataset.attrs.get(_STATED, "{}"))))


def require_used(
    declared: Declared, used: Iterable[str], file_values: Mapping[str, str] | None = None, which: str = ""
) -> None:
    """Raise InputError for declarations that no file needs.

    Parameters
    ----------
    declared
        The declarations.
    used
        Fields used by any of the files.
    file_values
        Values of the files that differ from the declared ones, see ``stated_in``.
    which
        Text in front of the key in the message.

    Raises
    ------
    InputError
        If every file states another value, or has no such property.
    """
    otherwise = file_values or {}
    for name in sorted(declared.declared_fields() - set(used)):
        allowed = "none: no file needs it"
        if name in otherwise:
            allowed = f"{otherwise[name]}, or none: the file states it itself"
        raise InputError(f"declared {which}{_KEYS[name]}", _value_text(getattr(declared, name)), allowed)


def scaled(values: NDArray, factor: float) -> NDArray:
    """Values times a factor, of the same type of floats.

    Parameters
    ----------
    values
        Array of any shape.
    factor
        Number.

    Returns
    -------
    NDArray
        The same array where the factor is 1; integers become floats.
    """
    return values if factor == 1 else (values * np.float64(factor)).astype(np.result_type(values.dtype, np.float32))


def sorted_planes(
    path: Path, planes: NDArray, wavelength_nm: NDArray[np.float64]
) -> tuple[NDArray, NDArray[np.float64]]:
    """Planes and wavelengths in ascending order.

    Parameters
    ----------
    path
        File, for the message.
    planes
        (..., w) values.
    wavelength_nm
        (w,) nm.

    Returns
    -------
    planes : NDArray
        (..., w), the same array where it is in order.
    wavelength_nm : NDArray
        (w,) nm, ascending.

    Raises
    ------
    InputError
        If a wavelength occurs twice.
    """
    order = np.argsort(wavelength_nm, kind="stable")
    ascending = np.asarray(wavelength_nm, float)[order]
    twice = np.flatnonzero(np.diff(ascending) == 0)
    if twice.size:
        raise InputError(f"{path}: wavelength", f"{ascending[twice[0]]:g} nm twice", "each wavelength once")
    if np.array_equal(order, np.arange(order.size)):
        return planes, ascending
    return planes[..., order], ascending
