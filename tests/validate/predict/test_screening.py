"""Rays of screening: those of the complete prediction in small pictures, fewer in large ones."""

import numpy as np
import pytest
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.rendering.effects import catalogue
from cboxlab.rendering.perturbation import SMALL_PICTURE_PX, patch_light
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
    assert complete.screening().small_px == complete.small_px > complete.sketch().small_px
    assert complete.sketch().transport is complete.transport


def test_a_coat_is_sketched_with_fewer_rays_and_the_same_light(complete):
    """Pixels without rays have the light of their neighbours: its mean over a paint stays, its scatter decreases."""
    scene, transport, responses = complete.scene, complete.transport, np.ones((1, len(WAVELENGTH_NM)))
    light = scene.lamp_radiance(WAVELENGTH_NM)
    coats = []
    for small_px in (SMALL_PICTURE_PX, 0):
        args = transport, scene, complete.effective_nm, WAVELENGTH_NM, responses, light
        coat = catalogue()["gloss"].apply(patch_light(*args, small_px=small_px), "white", 0.2, 0.25)
        coats.append(coat.added.ravel()[transport.pixels_of(list(scene.materials).index("white"))])
    everywhere, sketched = coats
    assert sketched.mean() == pytest.approx(everywhere.mean(), rel=0.05)
    assert np.count_nonzero(everywhere != sketched) > everywhere.size / 4
    assert np.corrcoef(everywhere, sketched)[0, 1] > 0.9


def test_a_large_picture_is_screened_with_fewer_rays_that_are_traced_once(complete, monkeypatch):
    """Light by both agrees on average, and a second predictor traces no new rays."""
    monkeypatch.setattr(module, "SMALL_PICTURE_PX", 24 * 24 - 1)
    screening = complete.screening()
    assert screening.gather_samples < complete.gather_samples
    assert screening.transport is not complete.transport
    assert complete.screening().transport is screening.transport
    wide = complete.transport.coverage > 0.2  # fewer rays may all miss a sliver
    direct, fewer = (each.transport.direct[wide].mean() for each in (complete, screening))
    assert fewer == pytest.approx(direct, rel=0.02)
    gathered, by_fewer = (np.asarray(each.transport.gather.sum(axis=1))[wide].mean() for each in (complete, screening))
    assert by_fewer == pytest.approx(gathered, rel=0.01)
