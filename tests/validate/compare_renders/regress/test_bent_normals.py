"""Shading normals bent on a face: cosines of the directions from which light comes."""

import numpy as np
import pytest
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validation.compare_renders.regress.causes.bent_normals import _first_moment, _picture
from cboxlab.validation.compare_renders.regress.variants import build_variants
from pictures import noisy

SIZE = 24


@pytest.fixture(scope="module")
def light():
    return build_variants(cornell_box(), cornell_camera(SIZE), noisy(1)).light


def test_a_longer_normal_scales_the_light_and_a_bent_one_does_not_scale_that_of_its_middle(light):
    transport = light.transport
    moment = _first_moment(light)
    arriving = light.fragment_direct + transport.gather @ light.patch_radiance()
    along = np.einsum("fwk,fk->fw", moment, transport.normal)
    # light from near the horizon is cut off
    bright = arriving > 0
    assert np.median(along[bright] / arriving[bright]) == pytest.approx(1.0, abs=0.01)
    assert (along <= arriving * (1 + 1e-5)).all()


def test_a_floor_bent_to_the_right_is_darker_where_the_lamp_is_on_the_left(light):
    transport = light.transport
    floor = transport.surface == [surface.name for surface in light.scene.surfaces].index("floor")
    change = _picture(light, _first_moment(light), floor[:, None] * np.array([1.0, 0.0, 0.0]))
    sums = np.zeros((SIZE * SIZE, 2))
    np.add.at(sums, transport.pixel[floor], np.stack([transport.position[floor, 0], np.ones(floor.sum())], axis=1))
    x = (sums[:, 0] / np.maximum(sums[:, 1], 1)).reshape(SIZE, SIZE)
    lamp = light.scene.lamp.surface.vertices_mm[:, 0].mean()
    of_floor = sums[:, 1].reshape(SIZE, SIZE) > 0
    total = change.sum(axis=0)
    assert total[of_floor & (x < lamp - 150)].mean() > 0 > total[of_floor & (x > lamp + 150)].mean()
    assert (total[~of_floor] == 0).all()
