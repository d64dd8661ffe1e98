"""The lamp's signal in a band."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from cboxlab.validation.capture_checks import scene_view


def test_the_lamps_signal_is_the_integral_over_its_band(monkeypatch):
    """A box-shaped curve of 100 nm and light of 3 per nm, times the constant and the optics' factor."""
    curve = np.where((WAVELENGTH_NM > 500) & (WAVELENGTH_NM <= 600), 0.5, 0.0)
    monkeypatch.setattr(scene_view, "response_curve", lambda *_: curve)
    monkeypatch.setattr(scene_view, "optical_factor", lambda *_: 0.25)
    light = SimpleNamespace(at=lambda wavelength_nm: np.full(len(wavelength_nm), 3.0))
    manifest = SimpleNamespace(lamp=SimpleNamespace(radiance=None), band=[SimpleNamespace(id="f550")])
    capture = SimpleNamespace(manifest=manifest, light=lambda spectrum: light)
    signals = scene_view.lamp_signals(capture, SimpleNamespace(constant=8.0), None)
    assert signals == pytest.approx([8 * 0.25 * 3 * 0.5 * INTEGRAL_GRID.weights[curve > 0].sum()])
    assert signals == pytest.approx([300.0], rel=0.03)
