"""The lamp's signal in a band."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from cboxlab.validation.capture_checks import scene_view


@pytest.mark.parametrize(
    ("low", "high", "tolerance"), [(500, 600, 0.03), (WAVELENGTH_NM[0] - 1, WAVELENGTH_NM[-1], 1e-9)]
)
def test_the_lamps_signal_is_the_integral_over_its_band(monkeypatch, low, high, tolerance):
    """A box-shaped curve, light that grows from 3 per nm at 550 nm, constant, optics; also to the grid's ends."""
    curve = np.where((WAVELENGTH_NM > low) & (WAVELENGTH_NM <= high), 0.5, 0.0)
    monkeypatch.setattr(scene_view, "response_curve", lambda *_: curve)
    monkeypatch.setattr(scene_view, "optical_factor", lambda *_: 0.25)
    light = SimpleNamespace(at=lambda wavelength_nm: 3.0 * wavelength_nm / 550)
    manifest = SimpleNamespace(lamp=SimpleNamespace(radiance=None), band=[SimpleNamespace(id="f550")])
    capture = SimpleNamespace(manifest=manifest, light=lambda spectrum: light)
    signals = scene_view.lamp_signals(capture, SimpleNamespace(constant=8.0), None)
    assert signals == pytest.approx(
        [8 * 0.25 * 3 * 0.5 * INTEGRAL_GRID.weights[curve > 0] @ WAVELENGTH_NM[curve > 0] / 550]
    )
    low_nm = max(low, WAVELENGTH_NM[0])
    assert signals == pytest.approx([3.0 * (high**2 - low_nm**2) / 2 / 550], rel=tolerance)
