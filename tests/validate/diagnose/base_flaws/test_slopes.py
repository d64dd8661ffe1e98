"""Changes of direct light on walls that lean or bulge."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validation.diagnose.base_flaws.slopes import slopes

SIZE = 12
LAMP = np.array([80.0, 300.0, 150.0])


def _wall(facet_surface=(0,), lamp=LAMP):
    """A wall in the plane z = 0 that a lamp shines on, in two bands; its columns by form."""
    v, u = np.indices((SIZE, SIZE)).reshape(2, -1) / (SIZE - 1)
    position = np.stack([200 * u, 200 * v, np.zeros(SIZE**2)], axis=1)
    transport = SimpleNamespace(
        coverage=np.ones(SIZE**2),
        pixel=np.arange(SIZE**2),
        position=position,
        normal=np.tile([0.0, 0.0, 1.0], (SIZE**2, 1)),
        direct=np.ones((SIZE**2, 1)),
        light=SimpleNamespace(
            lamps=[SimpleNamespace(centre=lamp)], tracer=SimpleNamespace(facet_surface=np.array(facet_surface))
        ),
    )
    return position, transport


def _cosine(position, normal):
    to_lamp = LAMP - position
    return np.sum(to_lamp * normal, axis=1) / np.linalg.norm(to_lamp, axis=1) / np.linalg.norm(normal)


def test_a_wall_that_leans_changes_direct_light_as_its_turned_normal_does():
    """Any turn of the normal is a sum of the two columns; by differences, to first order."""
    position, transport = _wall()
    direct = np.full((2, SIZE, SIZE), 100.0) * np.array([1.0, 2.0])[:, None, None]
    columns = list(slopes(direct, np.ones(direct.shape, bool), np.zeros((SIZE, SIZE), int), transport))
    lean = np.array([change for form, change in columns if form == "slopes:lean"])
    assert len(lean) == 2
    for turn in ((1e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (7e-4, -4e-4, 0.0)):
        rate = _cosine(position, np.array([0.0, 0.0, 1.0]) + turn) / _cosine(position, np.array([0.0, 0.0, 1.0]))
        change = ((rate - 1).reshape(SIZE, SIZE) * direct).ravel()
        fitted = np.linalg.lstsq(lean.T, change, rcond=None)[0] @ lean
        assert np.abs(fitted - change).max() < 2e-3 * np.abs(change).max()


@pytest.mark.parametrize("height_mm", [150.0, 12.0])
def test_a_lean_has_its_stated_size_also_where_light_grazes_the_wall(height_mm):
    """2 mrad in each direction: the part of the light along the wall over that on it, which counts as 0.1 at least."""
    lamp = np.array([80.0, 300.0, height_mm])
    position, transport = _wall(lamp=lamp)
    direct = np.full((1, SIZE, SIZE), 100.0)
    columns = slopes(direct, np.ones(direct.shape, bool), np.zeros((SIZE, SIZE), int), transport)
    lean = [change for form, change in columns if form == "slopes:lean"]
    cosine = height_mm / np.linalg.norm(lamp - position, axis=1)
    expected = 0.002 * np.sqrt(1 - cosine**2) / np.maximum(cosine, 0.1) * 100
    np.testing.assert_allclose(np.hypot(*lean), expected, rtol=1e-9)
    assert (cosine < 0.1).any() == (height_mm < 100)


def test_a_bulge_turns_both_sides_of_a_wall_apart_and_no_face_of_a_body():
    position, transport = _wall()
    signal = np.full((1, SIZE, SIZE), 100.0)
    used, face = np.ones(signal.shape, bool), np.zeros((SIZE, SIZE), int)
    columns = list(slopes(signal, used, face, transport))
    bulges = [change for form, change in columns if form == "slopes:bulge"]
    middle = position.mean(axis=0)
    for change, lean in zip(bulges, [c for form, c in columns if form == "slopes:lean"], strict=True):
        ratio = change / np.where(np.abs(lean) < 1e-9, np.nan, lean)
        axis = np.nanargmax(np.abs([np.nansum(ratio * (position - middle)[:, k]) for k in (0, 1)]))
        away = (position - middle)[:, axis]
        finite = np.isfinite(ratio)
        assert np.abs(np.corrcoef(ratio[finite], away[finite])[0, 1]) > 1 - 1e-9
        np.testing.assert_allclose((np.nanmin(ratio), np.nanmax(ratio)), (-2, 2), rtol=1e-9)
    assert list(slopes(signal, used, face, _wall((0, 0))[1])) == []
