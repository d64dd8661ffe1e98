"""A cube rendered by strips of rows is the cube rendered at once, within noise, in every format and at the seams."""

import numpy as np
import pytest
from cboxlab.render.device.variant import compiled
from cboxlab.render.files import read_cube
from cboxlab.render.files.cube_strips import ROWS
from cboxlab.scenes import cornell_camera
from cboxlab.validate.results import CubeSettings, cube, render, render_file
from helpers.boxes import BANDS

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")

SIZE = ROWS + 24
SETTINGS = CubeSettings(np.asarray(BANDS), samples=32, seed=3)


@pytest.fixture
def by_strips(tmp_path, monkeypatch):
    monkeypatch.setattr(cube, "LARGEST_IN_MEMORY", 0)
    _, notes = render_file(tmp_path / "a.nc", None, cornell_camera(SIZE), SETTINGS)
    return read_cube(tmp_path / "a.nc"), notes


def test_strips_agree_with_the_whole_picture(by_strips):
    """Rows from the same patches, with other random numbers below the first strip: the first strip is the whole
    picture's to the rounding of its camera; below it differences are as large as the errors say (a variance of
    8 batches each: F(1, 14), of mean 14/12)."""
    strips, notes = by_strips
    result = render(None, wavelengths=BANDS, camera=cornell_camera(SIZE), samples=32, seed=3)
    whole = result.cube
    difference = (strips["radiance"] - whole["radiance"]).values
    variance = (strips["standard_error"] ** 2 + whole["standard_error"] ** 2).values
    lit = variance > 0
    assert np.abs(difference[:ROWS]).max() < 1e-3 * float(whole["radiance"].max())
    below = lit.copy()
    below[:ROWS] = False
    assert np.any(difference[below] != 0)
    assert np.mean(difference[below] ** 2 / variance[below]) == pytest.approx(14 / 12, rel=0.15)
    across = difference[ROWS].sum(axis=0) / np.sqrt(variance[ROWS].sum(axis=0))
    assert np.abs(across).max() < 4
    assert notes[0].startswith("standard error")


def test_other_formats_hold_the_same_strips(by_strips, tmp_path):
    render_file(tmp_path / "a.exr", None, cornell_camera(SIZE), SETTINGS)
    exr, strips = read_cube(tmp_path / "a.exr"), by_strips[0]
    assert exr["radiance"].values == pytest.approx(strips["radiance"].values, rel=1e-6)
