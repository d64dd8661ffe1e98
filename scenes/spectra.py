"""Spectra: sampled functions of wavelength, interpolated linearly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from cboxlab.utils.arguments import described
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import path_inside, suggestion
from cboxlab.utils.input_files import read_rows, separator_hint
from cboxlab.utils.numbers import number_of
from numpy.typing import ArrayLike, NDArray

from .spectrum_readers import is_plain_table, read_instrument_file

__all__ = ["Spectrum", "as_spectrum", "planck", "read_spectra", "read_spectrum"]

#: Value beyond a table: that of its end ("hold", reflectances) or zero ("zero", radiances, transmittances, quantum
#: efficiencies).
Outside = Literal["hold", "zero"]


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Function of wavelength, linear between samples.

    Raises
    ------
    InputError
        If the tables differ in length, are empty or not finite, or the wavelengths do not ascend.

    Examples
    --------
    >>> from cboxlab.scenes import Spectrum
    >>> Spectrum([400, 700], [0.1, 0.4]).at([500, 800]).round(3).tolist()
    [0.2, 0.4]
    """

    #: (n,) wavelengths, nm, strictly ascending.
    wavelength_nm: NDArray[np.float64]
    #: (n,) finite values, in the unit of the quantity (reflectance 1, radiance W m^-2 sr^-1 nm^-1).
    values: NDArray[np.float64]
    #: Value beyond the table.
    outside: Outside = "hold"

    def __post_init__(self) -> None:
        wavelength = np.asarray(self.wavelength_nm, dtype=np.float64)
        values = np.asarray(self.values, dtype=np.float64)
        if wavelength.ndim != 1 or wavelength.shape != values.shape or wavelength.size == 0:
            shapes = f"shapes {wavelength.shape} and {values.shape}"
            raise InputError("spectrum", shapes, "two 1-D tables of equal length, not empty")
        if not (np.all(np.isfinite(wavelength)) and np.all(np.isfinite(values))):
            raise InputError("spectrum", "a value that is not a finite number", "finite numbers")
        if np.any(np.diff(wavelength) <= 0):
            bad = int(np.argmax(np.diff(wavelength) <= 0))
            pair = f"{wavelength[bad]:g} nm followed by {wavelength[bad + 1]:g} nm"
            raise InputError("spectrum", pair, "ascending wavelengths")
        object.__setattr__(self, "wavelength_nm", wavelength)
        object.__setattr__(self, "values", values)

    def at(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Values at wavelengths.

        Parameters
        ----------
        wavelength_nm
            Wavelengths of any shape, nm.

        Returns
        -------
        NDArray
            Values of the same shape.
        """
        beyond = 0.0 if self.outside == "zero" else None
        wavelength = np.asarray(wavelength_nm, float)
        return np.interp(wavelength, self.wavelength_nm, self.values, left=beyond, right=beyond)

    def scaled(self, factor: float) -> Spectrum:
        """Spectrum times a number.

        Parameters
        ----------
        factor
            The number.

        Returns
        -------
        Spectrum
            The spectrum, with the same value beyond the table.
        """
        return Spectrum(self.wavelength_nm, self.values * factor, self.outside)


def as_spectrum(table: Spectrum | ArrayLike, values: ArrayLike | None, outside: Outside, where: str) -> Spectrum:
    """Spectrum of an argument: a spectrum, one number, or wavelengths with their values.

    Parameters
    ----------
    table
        A spectrum, which is returned; a number, where ``values`` is None; or wavelengths (n,) in nm.
    values
        (n,) values at these wavelengths.
    outside
        Value beyond the table; of a number always "hold".
    where
        Name of the argument, for the error.

    Returns
    -------
    Spectrum
        The spectrum.

    Raises
    ------
    InputError
        If the arguments are none of these.
    """
    if isinstance(table, Spectrum) and values is None:
        return table
    try:
        first = np.asarray(table, np.float64)
        second = None if values is None else np.asarray(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        first, second = np.array(np.nan), None
    if second is not None:
        try:
            return Spectrum(first, second, outside)
        except InputError as error:
            raise InputError(where, error.found, error.expected) from None
    if first.ndim == 0 and np.isfinite(first):
        return Spectrum(np.array([550.0]), first[None], "hold")
    raise InputError(where, described(table), "a Spectrum, one number, or wavelengths in nm and their values")


def planck(wavelength_nm: ArrayLike, temperature_k: float) -> NDArray[np.float64]:
    """Planck's spectral radiance relative to its value at 550 nm.

    L is proportional to lambda^-5 / (exp(c2 / (lambda T)) - 1), with c2 = 0.014387769 m K (CODATA 2018).

    Parameters
    ----------
    wavelength_nm
        Wavelengths of any shape, nm.
    temperature_k
        Temperature T, K.

    Returns
    -------
    NDArray
        Relative radiance of the same shape.

    Examples
    --------
    >>> from cboxlab.scenes.spectra import planck
    >>> planck([550.0, 700.0], 2900.0).round(2).tolist()
    [1.0, 2.07]
    """
    c2_nm = 0.014387769e9
    wavelength = np.asarray(wavelength_nm, float)
    photon = np.expm1(c2_nm / (550.0 * temperature_k)) / np.expm1(c2_nm / (wavelength * temperature_k))
    return (550.0 / wavelength) ** 5 * photon


def read_spectra(path: Path, outside: Outside = "hold") -> dict[str, Spectrum]:
    """Spectra of a CSV file by column name.

    Parameters
    ----------
    path
        A file with a header row. Its first column is ``wavelength_nm``, ascending.
    outside
        Value of the spectra beyond the table.

    Returns
    -------
    dict[str, Spectrum]
        Spectra in the order of the columns.

    Raises
    ------
    InputError
        If the file cannot be read or is faulty; the error names file, line and column of the first fault.
    """
    try:
        state = path.stat()
    except OSError:
        return _read_table(path, outside)
    return dict(_table_as_of(path, outside, state.st_mtime_ns, state.st_size))


@lru_cache(maxsize=32)
def _table_as_of(path: Path, outside: Outside, changed_ns: int, size: int) -> dict[str, Spectrum]:
    """Table of one version of a file, cached: a capture reads the same files many times."""
    return _read_table(path, outside)


def _read_table(path: Path, outside: Outside) -> dict[str, Spectrum]:
    """Spectra of a CSV file by column name."""
    if not is_plain_table(path):
        measured = read_instrument_file(path).spectra
        return {spectrum.name: Spectrum(spectrum.wavelength_nm, spectrum.values, outside) for spectrum in measured}
    lines = read_rows(path, "a CSV file of spectra")
    if len(lines) < 2:
        raise InputError(path, "no table", "a header row with wavelength_nm first, then rows of numbers")
    names = [name.strip() for name in lines[0][1]]
    if names[0] != "wavelength_nm":
        hint = separator_hint(names[0]) or "Rename it if it holds wavelengths in nm."
        raise InputError(f"{path}: header", f"first column '{names[0]}'", "first column 'wavelength_nm'", hint)
    if len(set(names)) < len(names) or "" in names:
        raise InputError(f"{path}: header", ", ".join(names), "a unique name for every column")
    table = np.empty((len(lines) - 1, len(names)))
    for index, (line, cells) in enumerate(lines[1:]):
        if len(cells) != len(names):
            raise InputError(f"{path}: line {line}", f"{len(cells)} cells", f"{len(names)} as in the header")
        for column, cell in enumerate(cells):
            table[index, column] = _number(cell, f"{path}: line {line}, {names[column]}")
        if index and table[index, 0] <= table[index - 1, 0]:
            raise InputError(
                f"{path}: line {line}, wavelength_nm",
                f"{table[index, 0]:g} after {table[index - 1, 0]:g}",
                "ascending wavelengths",
            )
    return {name: Spectrum(table[:, 0], table[:, i], outside) for i, name in enumerate(names) if i}


def _number(cell: str, where: str) -> float:
    """Finite number of a cell."""
    value = number_of(cell)
    if not np.isfinite(value):
        raise InputError(where, f"'{cell.strip()}'", "a finite number")
    return value


def read_spectrum(folder: Path, reference: str, outside: Outside = "hold") -> Spectrum:
    """Spectrum of one column of a CSV file.

    Parameters
    ----------
    folder
        Folder in which the file must lie.
    reference
        File and column as ``"file.csv:column"``.
    outside
        Value beyond the table.

    Returns
    -------
    Spectrum
        The spectrum.

    Raises
    ------
    InputError
        If the reference has no column, the path leaves the folder, the column is unknown, or the file is faulty.
    """
    name, separator, column = reference.rpartition(":")
    if not separator:
        raise InputError(f"{folder}: {reference}", "no column", "'file.csv:column'")
    path = path_inside(folder, name, f"{folder}: {reference}")
    spectra = read_spectra(path, outside)
    if column not in spectra:
        expected = f"one of {', '.join(spectra)}" if spectra else "a table with columns besides wavelength_nm"
        raise InputError(path, f"no column '{column}'", expected, suggestion(column, spectra))
    return spectra[column]
