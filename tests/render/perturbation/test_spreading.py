"""Traced pixels that stand for their neighbours on the same face."""

import numpy as np
import pytest
from cboxlab.rendering.perturbation.spreading import fewer_rays, grid_step, spreading

SIDE = 184


@pytest.mark.parametrize("step", [2, 3])
def test_neighbours_of_one_face_give_a_plane_and_no_other_face(step):
    """Each face's own plane comes back between pixels of the grid; pixels of several faces are traced."""
    rows, columns = np.indices((SIDE, SIDE))
    face = np.where(columns < rows // 2 + 40, 0, 1)
    face[100, :] = -1
    planes = np.where(face == 0, 3.0 + 0.5 * rows - 0.2 * columns, 1000.0 + 0.1 * rows)
    weights = spreading(face, np.ones(face.shape), step)
    traced = (weights.diagonal() > 0).reshape(face.shape)
    values = (weights @ np.where(traced, planes, np.nan_to_num(np.inf)).ravel()).reshape(face.shape)
    assert traced[::step, ::step].all() and traced[face == -1].all() and traced.mean() < 0.3
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    np.testing.assert_allclose(values[traced], planes[traced])
    # next to a border all traced neighbours may lie to one side, at most a step off less a pixel
    np.testing.assert_allclose(values, planes, atol=0.71 * (step - 1))
    np.testing.assert_allclose(values[1:97, 2:38], planes[1:97, 2:38], atol=1e-9)


def test_the_edge_of_a_shadow_is_traced_and_a_gradient_is_not():
    """Light that falls by a third along one row is linear between neighbours; a step of it is not."""
    face, rows = np.zeros((SIDE, SIDE), int), np.indices((SIDE, SIDE))[0]
    gradient = 1 + 0.5 * rows / SIDE
    shadow = np.where(rows < 91, gradient, 0.5 * gradient)
    smooth, edge = (spreading(face, light, 2).diagonal().reshape(face.shape) > 0 for light in (gradient, shadow))
    further = np.flatnonzero((edge & ~smooth).any(axis=1))
    assert list(further) == [91] and edge[91].all()


def test_small_pictures_are_traced_everywhere_and_large_ones_on_as_many_rows():
    sides = (8, 64, 90, 128, 256, 512)
    assert [grid_step(side**2) for side in sides] == [1, 1, 1, 2, 4, 8]
    assert [fewer_rays(256, side**2) for side in sides] == [256, 256, 256, 256, 128, 64]
