"""Portable float maps."""

import numpy as np
import pytest
from cboxlab.utils.errors import InputError
from cboxlab.validation.compare_renders.plain_pictures import read_plain
from cboxlab.validation.compare_renders.scene_pictures import cube_paths, read_pfm, read_scene_picture

VALUES = np.random.default_rng(0).random((4, 5, 3), np.float32)


def write(path, kind=b"PF", scale=b"-1.0", values=VALUES, order="<f4"):
    """A file as its format is described: rows from the bottom to the top, columns before rows in the header."""
    path.write_bytes(kind + b"\n5 4\n" + scale + b"\n" + values[::-1].astype(order).tobytes())
    return path


@pytest.mark.parametrize(("scale", "order"), [(b"-1.0", "<f4"), (b"1", ">f4"), (b"-1.000000e+00", "<f4")])
def test_colours_are_read_from_the_top_row_in_both_orders_of_bytes(tmp_path, scale, order):
    path = write(tmp_path / "a.pfm", scale=scale, order=order)
    assert cube_paths(str(tmp_path)) == (path,)
    np.testing.assert_array_equal(read_scene_picture(path)["rgb"], VALUES)
    names, planes, _ = read_plain(path)
    assert names == ("R", "G", "B")
    np.testing.assert_array_equal(np.moveaxis(planes, 0, -1), VALUES)


def test_grey_is_one_plane_and_no_picture_in_colour(tmp_path):
    path = write(tmp_path / "a.pfm", b"Pf", values=VALUES[..., 0])
    np.testing.assert_array_equal(read_pfm(path), VALUES[None, ..., 0])
    with pytest.raises(InputError, match="grey"):
        read_scene_picture(path)


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (b"PF\n5 4\n-1.0\n" + bytes(239), "239 bytes after the header; expected 240 for 5 x 4 px"),
        (b"PF\n0 4\n-1.0\n", "expected 0"),
        (b"P6\n5 4\n255\n" + bytes(60), "no header of a PFM"),
        (b"PF\n999999 999999\n-1.0\n", "values"),
        (b"", "no header"),
    ],
)
def test_damaged_files_are_refused(tmp_path, content, fault):
    path = tmp_path / "a.pfm"
    path.write_bytes(content)
    with pytest.raises(InputError, match=fault):
        read_pfm(path)
