"""Signals behind a filter's table, as stated and shifted."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.quality.filters import _change_of_constant, _signal
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM


@pytest.mark.parametrize("line_nm", [540.0, 550.0, 565.0, 640.0])
def test_a_line_passes_by_the_tables_value_at_its_wavelength(line_nm):
    table_nm, transmittance = np.array([530.0, 550.0, 560.0, 580.0]), np.array([0.0, 0.8, 0.6, 0.2])
    light = 3.0 * (line_nm == WAVELENGTH_NM)
    expected = 3.0 * {540.0: 0.4, 550.0: 0.8, 565.0: 0.5, 640.0: 0.0}[line_nm]
    assert _signal(light, table_nm, transmittance) == pytest.approx(expected)


@pytest.mark.parametrize("line_in", ["reference", "efficiency", "lens"])
def test_a_shifted_table_changes_the_constant_by_what_then_passes(line_in):
    """A line at 550 nm, in the light or in one of the curves before the sensor; a triangle moved by half its width."""
    nm = WAVELENGTH_NM.astype(float)
    curves = {name: np.ones(nm.size) for name in ("reference", "efficiency", "lens")}
    curves[line_in] = 1.0 * (nm == 550)
    spectra = {name: Spectrum(nm, curve) for name, curve in curves.items()}
    spectra["filter"] = Spectrum(np.array([540.0, 550.0, 560.0]), np.array([0.0, 1.0, 0.0]), "zero")
    manifest = SimpleNamespace(
        camera=SimpleNamespace(quantum_efficiency="efficiency"), lens=SimpleNamespace(transmittance="lens")
    )
    capture = SimpleNamespace(
        manifest=manifest, references=lambda band: [SimpleNamespace(radiance="reference")], light=spectra.__getitem__
    )
    band = SimpleNamespace(id="f550", transmittance="filter")
    assert _change_of_constant(capture, band, 5.0) == pytest.approx(np.log(0.5))
