"""Shapes of slow errors over a face: of unit size, whatever the size of the face."""

import numpy as np
import pytest
from cboxlab.validation.diagnose.base_flaws.columns import _field, _meeting_faces, _Picture, _shading


@pytest.mark.parametrize("size", [24, 48])
def test_shading_over_a_face_has_unit_size(size):
    face = np.zeros((size, size), int)
    face[:, size // 2 :] = 1
    signal = np.full((2, size, size), 5.0)
    picture = _Picture(signal, np.ones(signal.shape, bool), face, np.zeros(signal.shape), np.ones((2, 2)))
    columns = [(kind, column.reshape(signal.shape) / 5.0) for kind, column in _shading(picture, 1)]
    plain = [column for kind, column in columns if kind == "shading:1"]
    assert len(plain) == 2
    for column in plain:
        assert column[:, face == 1].min() == pytest.approx(-1) and column[:, face == 1].max() == pytest.approx(1)
        assert not column[:, face == 0].any()
    for kind, column in columns:
        assert np.abs(column).max() <= 1 + 1e-9, kind


def test_faces_meet_along_four_pixels_and_nothing_meets_what_is_no_face():
    face = np.full((8, 9), -1)
    face[:, :3], face[:4, 3:6], face[7, 3] = 0, 1, 2  # the last one shares three sides of pixels, one with face 0
    assert _meeting_faces(face) == [(0, 1)]
    assert _meeting_faces(np.where(face == 1, -1, face)) == []


def test_slow_changes_of_the_picture_are_relative_cosines():
    """Of the first order across: from +1 at the left edge to -1 at the right one, of the signal of each band."""
    signal = np.array([5.0, 2.0])[:, None, None] * np.ones((2, 6, 8))
    picture = _Picture(
        signal, np.ones(signal.shape, bool), np.zeros((6, 8), int), np.zeros(signal.shape), np.ones((2, 2))
    )
    changes = np.array([column.reshape(signal.shape) / signal for _, column in _field(picture)])
    assert np.abs(changes).max() <= 1
    across = np.cos(np.pi * (np.arange(8) + 0.5) / 8) * np.ones((2, 6, 1))
    assert min(np.abs(change - across).max() for change in changes) < 1e-12
