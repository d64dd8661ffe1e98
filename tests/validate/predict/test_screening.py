"""Rays of screening: those of the complete prediction in small pictures, fewer in large ones."""

import numpy as np
import pytest
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validation.predict import predictor as module

NOTHING = (None,) * 3


@pytest.fixture
def complete():
    camera, bands = cornell_camera(24), np.array([550.0])
    return module.Predictor(cornell_box(), None, camera, *NOTHING, RenderSettings(), (), bands, None)


def test_a_small_picture_is_screened_with_the_rays_of_the_complete_prediction(complete):
    assert complete.screening().transport is complete.transport


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
