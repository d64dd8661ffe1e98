"""Signals behind a filter's table, as stated and shifted."""

import numpy as np
import pytest
from cboxlab.calibration.quality.filters import _signal
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM


@pytest.mark.parametrize("line_nm", [540.0, 550.0, 565.0, 640.0])
def test_a_line_passes_by_the_tables_value_at_its_wavelength(line_nm):
    table_nm, transmittance = np.array([530.0, 550.0, 560.0, 580.0]), np.array([0.0, 0.8, 0.6, 0.2])
    light = 3.0 * (line_nm == WAVELENGTH_NM)
    expected = 3.0 * {540.0: 0.4, 550.0: 0.8, 565.0: 0.5, 640.0: 0.0}[line_nm]
    assert _signal(light, table_nm, transmittance) == pytest.approx(expected)
