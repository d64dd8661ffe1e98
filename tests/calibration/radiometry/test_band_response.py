"""Band responses: how far signals depend on the steps of tables."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.instrument import BandResponse, tabulation_errors
from cboxlab.calibration.radiometry import filter_steps_nm
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID


def test_a_spectrum_that_begins_within_a_band_makes_the_larger_error():
    """By Euler and Maclaurin's formula: x (1 - x / 40), 0 beyond, has slopes of 1 and -1 at its ends."""
    grid = INTEGRAL_GRID
    x = grid.nm - grid.nm[0]
    falling = np.maximum(1 - x / 40, 0)
    inside = np.exp(-0.5 * ((grid.nm - 550) / 15) ** 2)
    responses = tuple(BandResponse(n, grid, curve, 2.0) for n, curve in (("a", falling), ("b", inside)))
    light = Spectrum(grid.nm, x / 100)
    errors = tabulation_errors(responses, light, (5.0, 5.0))
    signal = 40**2 / 6
    assert errors[0] == pytest.approx(-2 * (5**2 - 1) / 12 / signal, rel=0.01)
    assert abs(errors[1]) < 1e-6
    finer = tabulation_errors(responses, light, (2.0, 1.0))
    assert finer == pytest.approx([errors[0] * (2**2 - 1) / (5**2 - 1), 0.0], rel=0.01, abs=1e-12)


def test_the_step_of_a_filter_is_that_of_its_table_and_at_most_5_nm():
    tables = {name: np.arange(400.0, 701.0, step) for name, step in (("fine", 1), ("middling", 4), ("coarse", 20))}
    columns = [*tables, None]
    capture = SimpleNamespace(
        manifest=SimpleNamespace(band=[SimpleNamespace(transmittance=column) for column in columns]),
        light=lambda column: Spectrum(tables[column], np.ones(tables[column].size)),
    )
    assert filter_steps_nm(capture) == [1.0, 4.0, 5.0, 5.0]
