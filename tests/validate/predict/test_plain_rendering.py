"""Spectra of a picture that was rendered at a few wavelengths."""

from types import SimpleNamespace

import numpy as np
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.validation.predict import plain_rendering


def test_the_picture_is_linear_between_the_rendered_wavelengths(monkeypatch):
    """A reflectance that is linear in the wavelength comes back at every wavelength."""
    image = SimpleNamespace(coefficients=None, coverage=None, facet_surface=None, surface_names=())
    monkeypatch.setattr(plain_rendering, "render_stock", lambda job, progress: image)
    scene = cornell_box()
    spectra = plain_rendering.render_plainly(scene, cornell_camera(4), None, 1).spectra
    linear = 0.2 + 0.001 * (np.asarray(plain_rendering._WAVELENGTHS) - 380)
    expected = (0.2 + 0.001 * (WAVELENGTH_NM - 380)) * scene.lamp_radiance(WAVELENGTH_NM)
    np.testing.assert_allclose(linear @ spectra, expected, rtol=1e-9)
