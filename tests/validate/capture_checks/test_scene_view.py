"""The lamp's signal in a band, and light of paints over their rendering."""

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


def test_light_of_a_paint_is_that_measured_over_that_rendered(monkeypatch):
    """Two paints in three bands of other levels; a displaced table sees a quarter more of the lamp.

    Pixels at the border of the paints, which are far off here, do not count.
    """
    rng, shape = np.random.default_rng(3), (3, 12, 16)
    surface = np.broadcast_to((np.arange(16) >= 7).astype(int), shape[1:])
    factors = np.array([[0.8, 1.1, 1.7], [1.3, 0.9, 0.5]])
    radiance = rng.uniform(0.1, 0.4, shape)
    relative = radiance * factors.T[:, surface]
    relative[..., 6:8] *= 50
    full = np.array([200.0, 400.0, 800.0])
    monkeypatch.setattr(scene_view, "lamp_signals", lambda *values: full * (1.25 if len(values) > 3 else 1))
    surfaces = [SimpleNamespace(material=name) for name in ("white", "red")]
    preview = SimpleNamespace(radiance=radiance, on_surface=np.ones(shape[1:], bool), surface=surface, step=2)
    view = scene_view.SceneView(SimpleNamespace(surfaces=surfaces), None, preview, np.full((2, 3), 0.5), relative)
    capture = SimpleNamespace(band_ids=("r", "g", "b"), manifest=SimpleNamespace(lamp=None))
    light = scene_view.light_of_paints(capture, None, None, {}, view, np.array([0.0]))
    np.testing.assert_allclose(light.ratios[0], np.log(factors / 1.25))
    inside = [relative[:, :, :6], relative[:, :, 8:]]
    np.testing.assert_allclose(light.signal, [full * np.median(part, axis=(1, 2)) for part in inside])
    np.testing.assert_allclose(light.scatter, 0, atol=1e-12)
