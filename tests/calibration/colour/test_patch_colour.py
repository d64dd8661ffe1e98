"""Errors of measured patches: against tables, in XYZ under D65 and in CIELab, the white patch being the white."""

import numpy as np
import pytest
from cboxlab.calibration.capture import Label
from cboxlab.calibration.colour.patch_colour import patch_errors
from cboxlab.calibration.colour.patches import PatchTable
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import FILTER_GRID

GRID = FILTER_GRID.between(380.0, 730.0)
CENTRES = np.arange(400.0, 701.0, 50.0)
LABELS = (Label(1, "grey", "grey"), Label(2, "white", "white"), Label(3, "no table", "none"))
KNOWN = {
    name: Spectrum(np.array([380.0, 780.0]), np.full(2, value)) for name, value in (("grey", 0.45), ("white", 0.9))
}

#: XYZ of D65 by the CIE 1931 observer, Y = 100 (CIE 15:2018, table 3.1).
D65 = (95.04, 100.0, 108.88)


def table(grey):
    """Even patches through seven filters, the grey one as bright as ``grey``."""
    filters = np.exp(-0.5 * ((GRID.nm - CENTRES[:, None]) / 10) ** 2)
    filters /= filters.sum(axis=1, keepdims=True)
    reflectance = np.array([grey, 0.9, 0.2])[:, None] * np.ones(len(CENTRES))
    return PatchTable(
        LABELS,
        tuple(f"f{c:.0f}" for c in CENTRES),
        reflectance,
        np.zeros_like(reflectance),
        np.zeros(len(CENTRES)),
        {},
        GRID,
        filters,
        LABELS[1],
        (),
    )


def test_an_even_grey_of_half_the_white_has_half_its_xyz_and_no_error():
    """To 0.3 %, the part of X and Z from beyond 400 to 700 nm, over which the program integrates."""
    errors = patch_errors(table(0.45), KNOWN)
    assert errors.labels == (1,)
    assert errors.known_xyz[0] == pytest.approx(np.divide(D65, 2), rel=3e-3)
    assert errors.reflectance == pytest.approx(np.zeros((1, len(CENTRES))), abs=1e-6)
    assert errors.delta_e_ab == pytest.approx(0, abs=0.05)
    assert errors.delta_e_2000 == pytest.approx(0, abs=0.05)


def test_a_grey_measured_too_bright_differs_in_lightness():
    """Of L* = 116 (Y / Yn)^(1/3) - 16 alone."""
    errors = patch_errors(table(0.54), KNOWN)
    expected = 116 * (np.cbrt(0.6) - np.cbrt(0.5))
    assert errors.delta_e_ab == pytest.approx(expected, abs=0.05)
    assert errors.reflectance == pytest.approx(np.full((1, len(CENTRES)), 0.09), abs=1e-6)


def test_without_a_table_there_are_no_errors():
    assert patch_errors(table(0.45), {"white": KNOWN["white"]}) is None
