"""XYZ of measured patches under a standard illuminant, their errors, and patches.csv."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from numpy.typing import NDArray

from ..instrument import colour_matching_functions
from .colour_error import lab_differences
from .patches import PatchTable

__all__ = ["ILLUMINANT", "PatchErrors", "patch_errors", "patch_xyz", "patches_csv", "smoothest_spectra"]

#: CIE standard illuminant under which the patches' X, Y, Z are stated.
ILLUMINANT = "D65"


def smoothest_spectra(filters: NDArray[np.float64], wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix M for which M r is the spectrum of least curvature with the band means r.

    The integral of the squared second derivative is minimised with the band means as constraints (Lagrange
    multipliers).

    Parameters
    ----------
    filters
        (band, wavelength) filters of unit sum.
    wavelength_nm
        Even grid of wavelengths, nm.

    Returns
    -------
    NDArray
        (wavelength, band) matrix M, without unit.
    """
    count, bands = wavelength_nm.size, filters.shape[0]
    curvature = np.diff(np.eye(count), 2, axis=0)
    system = np.zeros((count + bands, count + bands))
    system[:count, :count] = curvature.T @ curvature
    system[:count, count:] = filters.T
    system[count:, :count] = filters
    right = np.vstack([np.zeros((count, bands)), np.eye(bands)])
    return np.asarray(np.linalg.solve(system, right)[:count], np.float64)


def _illuminant() -> NDArray[np.float64]:
    """(3, 301) colour-matching functions times the illuminant's power on WAVELENGTH_NM."""
    from colour import SDS_ILLUMINANTS  # slow to import, and only needed here

    illuminant = SDS_ILLUMINANTS[ILLUMINANT]
    return colour_matching_functions() * np.interp(WAVELENGTH_NM, illuminant.wavelengths, illuminant.values)


@dataclass(frozen=True, eq=False)
class PatchErrors:
    """Errors of measured patches against their tables, without the white patch (the scale)."""

    #: Numbers of n patches with a tabulated reflectance.
    labels: tuple[int, ...]
    #: (n, band) measured minus tabulated band reflectance.
    reflectance: NDArray[np.float64]
    #: (n, 3) X, Y, Z of the tabulated spectra, the white patch at Y = 100.
    known_xyz: NDArray[np.float64]
    #: (n,) Delta E*ab (1976) with the white patch as white.
    delta_e_ab: NDArray[np.float64]
    #: (n,) CIEDE2000 with the white patch as white.
    delta_e_2000: NDArray[np.float64]


def patch_errors(table: PatchTable, reference: Mapping[str, Spectrum]) -> PatchErrors | None:
    """Errors of all patches with a tabulated reflectance.

    Parameters
    ----------
    table
        Measured patches.
    reference
        Tabulated reflectances by column name.

    Returns
    -------
    PatchErrors | None
        Errors without the white patch; None if no other patch has a reflectance.
    """
    measured, _ = patch_xyz(table)
    selected = [
        index
        for index, label in enumerate(table.labels)
        if label.column in reference and label.label != table.white.label and np.all(np.isfinite(measured[index]))
    ]
    if not selected:
        return None
    white = _illuminant() @ reference[str(table.white.column)].at(WAVELENGTH_NM)
    spectra = [reference[str(table.labels[index].column)] for index in selected]
    exact = np.stack([_illuminant() @ s.at(WAVELENGTH_NM) for s in spectra]) * 100.0 / white[1]
    bands = np.stack([table.filters @ s.at(table.grid.nm) for s in spectra])
    first, second = lab_differences(measured[selected], exact, np.broadcast_to(white * 100.0 / white[1], exact.shape))
    return PatchErrors(
        tuple(table.labels[index].label for index in selected),
        table.reflectance[selected] - bands,
        exact,
        first,
        second,
    )


def patch_xyz(table: PatchTable) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """X, Y, Z of patches under ILLUMINANT with the white patch at Y = 100.

    The spectrum is the smoothest one with the measured band reflectances. The standard deviations include those of the
    reflectances, not the error of this interpolation.

    Parameters
    ----------
    table
        Measured patches.

    Returns
    -------
    NDArray
        (n, 3) X, Y, Z.
    NDArray
        (n, 3) standard deviations.
    """
    spectra = smoothest_spectra(table.filters, table.grid.nm)
    matrix = _illuminant() @ spectra[table.grid.part(INTEGRAL_GRID)]
    white = table.reflectance[[label.label for label in table.labels].index(table.white.label)]
    matrix = matrix * 100.0 / (matrix[1] @ white)
    return table.reflectance @ matrix.T, np.sqrt(table.sigma**2 @ (matrix**2).T)


def patches_csv(table: PatchTable) -> str:
    """Text of patches.csv.

    The columns are label, name, reflectance per band, X, Y, Z, illuminant, and every sigma.

    Parameters
    ----------
    table
        Measured patches.

    Returns
    -------
    str
        Header and one row per patch.
    """
    xyz, xyz_sigma = patch_xyz(table)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    quantities = [*table.bands, "X", "Y", "Z"]
    writer.writerow(["label", "name", *quantities, "illuminant", *(f"{name}_sigma" for name in quantities)])
    for index, label in enumerate(table.labels):
        values = [f"{value:.5f}" for value in (*table.reflectance[index], *xyz[index])]
        sigmas = [f"{value:.5f}" for value in (*table.sigma[index], *xyz_sigma[index])]
        writer.writerow([label.label, label.name, *values, ILLUMINANT, *sigmas])
    return stream.getvalue()
