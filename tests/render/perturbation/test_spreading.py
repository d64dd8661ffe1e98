"""Traced pixels that stand for their neighbours on the same face."""

import numpy as np
from cboxlab.rendering.perturbation.spreading import spreading

SIDE = 184


def test_neighbours_of_one_face_give_a_plane_and_no_other_face():
    """Each face's own plane comes back where all four sides have neighbours; pixels of several faces are traced."""
    rows, columns = np.indices((SIDE, SIDE))
    face = np.where(columns < rows // 2 + 40, 0, 1)
    face[100, :] = -1
    planes = np.where(face == 0, 3.0 + 0.5 * rows - 0.2 * columns, 1000.0 + 0.1 * rows)
    weights = spreading(face)
    traced = (weights.diagonal() > 0).reshape(face.shape)
    values = (weights @ np.where(traced, planes, np.nan_to_num(np.inf)).ravel()).reshape(face.shape)
    assert traced[::2, ::2].all() and traced[face == -1].all() and traced.mean() < 0.3
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    np.testing.assert_allclose(values[traced], planes[traced])
    # next to a border the traced neighbours lie to one side, at most half a step off
    np.testing.assert_allclose(values, planes, atol=0.71)
    np.testing.assert_allclose(values[1:98, 2:38], planes[1:98, 2:38], atol=1e-9)
