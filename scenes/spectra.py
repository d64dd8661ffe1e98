"""Spectra: sampled functions of wavelength, interpolated linearly."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError

__all__ = ["Spectrum", "planck", "read_spectra", "read_spectrum"]

Outside = Literal["hold", "zero"]


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A function of wavelength, linear between samples.

    wavelength_nm : (n,) strictly ascending, nm.
    values : (n,) finite; the unit is that of the quantity (reflectance 1, radiance W m^-2 sr^-1 nm^-1).
    outside : beyond the table the end value is held ("hold": reflectances) or the value is zero
        ("zero": everything that carries or passes light).
    """

    wavelength_nm: NDArray[np.float64]
    values: NDArray[np.float64]
    outside: Outside = "hold"

    def __post_init__(self) -> None:
        wavelength = np.asarray(self.wavelength_nm, dtype=np.float64)
        values = np.asarray(self.values, dtype=np.float64)
        if wavelength.ndim != 1 or wavelength.shape != values.shape or wavelength.size == 0:
            raise InputError("spectrum", f"shapes {wavelength.shape} and {values.shape}", "two equal 1-D tables")
        if not (np.all(np.isfinite(wavelength)) and np.all(np.isfinite(values))):
            raise InputError("spectrum", "a value that is not a finite number", "finite numbers")
        if np.any(np.diff(wavelength) <= 0):
            bad = int(np.argmax(np.diff(wavelength) <= 0))
            raise InputError(
                "spectrum", f"{wavelength[bad]:g} nm followed by {wavelength[bad + 1]:g} nm", "ascending wavelengths"
            )
        object.__setattr__(self, "wavelength_nm", wavelength)
        object.__setattr__(self, "values", values)

    def at(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Values at the given wavelengths (any shape, nm)."""
        edges = (0.0, 0.0) if self.outside == "zero" else (None, None)
        return np.interp(np.asarray(wavelength_nm, float), self.wavelength_nm, self.values, edges[0], edges[1])

    def scaled(self, factor: float) -> Spectrum:
        """The same spectrum times a number."""
        return Spectrum(self.wavelength_nm, self.values * factor, self.outside)


def planck(wavelength_nm: ArrayLike, temperature_k: float) -> NDArray[np.float64]:
    """Planck's spectral radiance relative to its value at 550 nm (CODATA c2 = 0.014387769 m K)."""
    c2_nm = 0.014387769e9
    wavelength = np.asarray(wavelength_nm, float)
    return (550.0 / wavelength) ** 5 * np.expm1(c2_nm / (550.0 * temperature_k)) / np.expm1(
        c2_nm / (wavelength * temperature_k)
    )


def read_spectra(path: Path, outside: Outside = "hold") -> dict[str, Spectrum]:
    """All columns of a CSV: header row, first column ``wavelength_nm`` ascending, the others spectra.

    Raises InputError naming the file, column and row of the first fault.
    """
    try:
        with open(path, newline="", encoding="utf-8") as stream:
            rows = [row for row in csv.reader(stream) if row and any(cell.strip() for cell in row)]
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "a readable CSV file") from None
    except UnicodeDecodeError:
        raise InputError(path, "bytes that are no text", "a CSV file in UTF-8") from None
    if len(rows) < 2 or rows[0][0].strip() != "wavelength_nm":
        raise InputError(path, "no table" if len(rows) < 2 else f"first column '{rows[0][0]}'",
                         "a header row that begins with wavelength_nm, then rows of numbers")  # fmt: skip
    names = [name.strip() for name in rows[0]]
    table = np.empty((len(rows) - 1, len(names)))
    for index, row in enumerate(rows[1:]):
        if len(row) != len(names):
            raise InputError(f"{path}: row {index + 2}", f"{len(row)} cells", f"{len(names)} as in the header")
        for column, cell in enumerate(row):
            try:
                value = float(cell)
            except ValueError:
                value = float("nan")
            if not np.isfinite(value):
                raise InputError(f"{path}: row {index + 2}, {names[column]}", f"'{cell.strip()}'", "a finite number")
            table[index, column] = value
    if np.any(np.diff(table[:, 0]) <= 0):
        bad = int(np.argmax(np.diff(table[:, 0]) <= 0))
        raise InputError(f"{path}: row {bad + 3}, wavelength_nm", f"{table[bad + 1, 0]:g} after {table[bad, 0]:g}",
                         "ascending wavelengths")  # fmt: skip
    return {name: Spectrum(table[:, 0], table[:, i], outside) for i, name in enumerate(names) if i}


def read_spectrum(folder: Path, reference: str, outside: Outside = "hold") -> Spectrum:
    """One column by reference ``"file.csv:column"``, the file relative to ``folder``."""
    name, separator, column = reference.rpartition(":")
    if not separator:
        raise InputError(f"{folder}: {reference}", "no column", "'file.csv:column'")
    spectra = read_spectra(folder / name, outside)
    if column not in spectra:
        raise InputError(folder / name, f"no column '{column}'", f"one of {', '.join(spectra)}")
    return spectra[column]
