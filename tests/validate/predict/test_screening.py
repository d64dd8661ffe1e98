"""Rays of screening: those of the complete prediction in small pictures, fewer in large ones."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.rendering.effects import catalogue
from cboxlab.rendering.perturbation import patch_light, spreading
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.validation.predict import predictor as module

NOTHING = (None,) * 3


@pytest.fixture
def complete():
    camera, bands = cornell_camera(24), np.array([550.0])
    return module.Predictor(cornell_box(), None, camera, *NOTHING, RenderSettings(), (), bands, None)


def test_a_small_picture_is_screened_with_the_rays_of_the_complete_prediction(complete):
    assert complete.screening().transport is complete.transport


def test_a_coat_is_traced_in_fewer_pixels_with_the_same_light(complete, monkeypatch):
    """Pixels without rays have the light of their neighbours: its mean over a paint stays, its scatter decreases."""
    scene, transport, responses = complete.scene, complete.transport, np.ones((1, len(WAVELENGTH_NM)))
    light, coats = scene.lamp_radiance(WAVELENGTH_NM), []
    for fewest in (24, 12):
        monkeypatch.setattr(spreading, "_GRID", fewest)
        args = replace(transport), scene, complete.effective_nm, WAVELENGTH_NM, responses, light
        coat = catalogue()["gloss"].apply(patch_light(*args), "white", 0.2, 0.25)
        coats.append(coat.added.ravel()[transport.pixels_of(list(scene.materials).index("white"))])
    everywhere, fewer = coats
    assert fewer.mean() == pytest.approx(everywhere.mean(), rel=0.05)
    assert np.count_nonzero(everywhere != fewer) > everywhere.size / 8
    assert np.corrcoef(everywhere, fewer)[0, 1] > 0.9


def test_a_large_picture_is_screened_with_fewer_rays_that_are_traced_once(complete, monkeypatch):
    """Light by both agrees on average, and a second predictor traces no new rays."""
    monkeypatch.setattr(module, "_SMALL_PICTURE_PX", 24 * 24 - 1)
    screening = complete.screening()
    assert screening.gather_samples < complete.gather_samples
    assert screening.transport is not complete.transport
    assert complete.screening().transport is screening.transport
    wide = complete.transport.coverage > 0.2  # fewer rays may all miss a sliver
    direct, fewer = (each.transport.direct[wide].mean() for each in (complete, screening))
    assert fewer == pytest.approx(direct, rel=0.02)
    gathered, by_fewer = (np.asarray(each.transport.gather.sum(axis=1))[wide].mean() for each in (complete, screening))
    assert by_fewer == pytest.approx(gathered, rel=0.01)
