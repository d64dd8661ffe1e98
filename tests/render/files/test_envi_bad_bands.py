"""Bad bands of ENVI cubes (bbl): left out and noted, whatever their values and wavelengths."""

import numpy as np
import pytest
from cboxlab.rendering.files import open_cube, read_cube
from cboxlab.utils.errors import InputError
from helpers.files.envi_files import LIGHT, NM, header_text, write


def read(tmp_path, *arguments):
    return read_cube(write(tmp_path / "cube", *arguments))


@pytest.mark.parametrize(
    ("bbl", "good"),
    [
        ("{0,1,1,1,1,0}", [1, 2, 3, 4]),
        ("{ 1, 1, 0, 0, 1, 1, }", [0, 1, 4, 5]),
        ("{1 1 1 1 1 0}", [0, 1, 2, 3, 4]),
        ("{1,1,1,1,1,1}", [0, 1, 2, 3, 4, 5]),
        ("{0.0,\n0.0,\n1.0,\n0.0,\n0.0,\n0.0}", [2]),
        ("{1,0,1,0,1,0}", [0, 2, 4]),
    ],
)
def test_bad_bands_are_left_out(tmp_path, bbl, good):
    path = write(tmp_path / "cube", header_text(bbl=bbl))
    cube = read_cube(path)
    np.testing.assert_array_equal(cube["wavelength"], NM[good])
    np.testing.assert_array_equal(cube["radiance"], LIGHT[..., good])
    assert ("bad (bbl)" in cube.attrs.get("reading_notes", "")) == (len(good) < 6)
    with open_cube(path) as mapped:
        np.testing.assert_array_equal(mapped["radiance"], LIGHT[..., good])


def test_a_bad_bands_values_and_wavelength_do_not_matter(tmp_path):
    values = LIGHT.copy()
    values[..., 0], values[..., 5] = np.nan, -1e6
    header = header_text(bbl="{0,1,1,1,1,0}", wavelength="{0, 450, 500, 550, 600, 600}", data_gain_values="{2}")
    np.testing.assert_allclose(read(tmp_path, header, values)["radiance"], 2 * values[..., 1:5])


@pytest.mark.parametrize(
    ("bbl", "message"),
    [
        ("{0,0,0,0,0,0}", "no good band"),
        ("{1,1}", "2 values"),
        ("{x}", "finite"),
        ("{1,1,0.5,1,1,1}", "0.5"),
        ("{1,1,1,1,1,1", "without a '}'"),
    ],
)
def test_lists_of_bad_bands_without_meaning_are_refused(tmp_path, bbl, message):
    with pytest.raises(InputError, match=f"bbl.*{message}"):
        read(tmp_path, header_text(bbl=bbl))


def test_many_bad_bands_are_counted(tmp_path):
    values = np.ones((2, 2, 20), np.float32)
    header = header_text(
        samples=2,
        lines=2,
        bands=20,
        wavelength="{" + ",".join(str(400 + 10 * i) for i in range(20)) + "}",
        bbl="{" + ",".join("0" * 8 + "1" * 12) + "}",
    )
    assert "left out: 8 bands" in read(tmp_path, header, values).attrs["reading_notes"]
