"""Captures whose frames are files of any format, also with several pictures."""

import re

import numpy as np
import OpenEXR
import pytest
import tifffile
from cboxlab.calibration import frame_readers
from cboxlab.calibration.capture import file_mosaic_notes, load_capture
from cboxlab.utils.errors import InputError
from helpers.fakes.capture import FakeCapture
from helpers.files.frame_files import write_dng, write_fits


def write_stack(path, stack):
    tifffile.imwrite(path, stack, photometric="minisblack")


@pytest.fixture
def folder(tmp_path):
    return FakeCapture(tmp_path / "capture", centres=(450, 550)).write()


def with_frames(folder, old, new):
    path = folder / "capture.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def band_frames(capture, folder):
    return "frames = [" + ", ".join(f'"{name}"' for name in capture.band("f450").frames) + "]"


@pytest.mark.parametrize("name", ["box.fits", "box.fits.gz", "box.fits.fz", "box.tif"])
def test_a_cube_counts_as_its_repeats(folder, name):
    """The same counts in one file give the same capture as in a file each."""
    before = load_capture(folder)
    stack = before.frames(before.band("f450"))
    assert len(stack) > 1
    write_fits(folder / name, stack) if "fits" in name else write_stack(folder / name, stack)
    with_frames(folder, band_frames(before, folder), f'frames = ["{name}"]')
    after = load_capture(folder)
    assert after.band("f450").frames == tuple(f"{name}[{k}]" for k in range(len(stack)))
    np.testing.assert_array_equal(after.frames(after.band("f450")), stack)
    np.testing.assert_array_equal(after.frame(f"{name}[1]"), stack[1])


@pytest.mark.parametrize(("names", "order"), [('"a.fits[1]"', [1]), ('"a.fits[1]", "a.fits[0]"', [1, 0])])
def test_single_pictures_of_a_cube(folder, names, order):
    before = load_capture(folder)
    stack = before.frames(before.band("f450"))
    write_fits(folder / "a.fits", stack)
    with_frames(folder, band_frames(before, folder), f"frames = [{names}]")
    after = load_capture(folder)
    np.testing.assert_array_equal(after.frames(after.band("f450")), stack[order])


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ('"a.fits[7]"', "the picture \\[7\\] of a.fits; expected 0 to 1"),
        ('"a.fits", "a.fits[0]"', "'a.fits\\[0\\]' next to 'a.fits'"),
        ('"b.fits[0]"', "'b.fits', which does not exist"),
    ],
)
def test_pictures_that_are_not_there(folder, names, message):
    before = load_capture(folder)
    write_fits(folder / "a.fits", before.frames(before.band("f450"))[:2])
    with_frames(folder, band_frames(before, folder), f"frames = [{names}]")
    with pytest.raises(InputError, match=message):
        load_capture(folder)


def test_a_frame_whose_name_ends_in_brackets(folder):
    before = load_capture(folder)
    name = before.band("f450").frames[0]
    renamed = name.replace(".tif", ".tif[3]")
    (folder / name).rename(folder / renamed)
    with_frames(folder, f'"{name}"', f'"{renamed}"')
    after = load_capture(folder)
    assert renamed in after.band("f450").frames and after.frame(renamed).shape == after.shape


def test_a_raw_file_in_a_capture(folder):
    before = load_capture(folder)
    image = before.frame(before.band("f450").frames[0])
    write_dng(folder / "IMG_0550.dng", image)
    with_frames(folder, band_frames(before, folder), 'frames = ["IMG_0550.dng"]')
    after = load_capture(folder)
    np.testing.assert_array_equal(after.frames(after.band("f450"))[0], image)


@pytest.mark.parametrize(("table", "phrases"), [("", "a sensor without mosaic"), ("GRBG", "the mosaic GRBG")])
def test_a_mosaic_that_the_file_states_is_noted(folder, table, phrases):
    before = load_capture(folder)
    assert file_mosaic_notes(before) == []
    write_dng(folder / "box.dng", before.frame(before.band("f450").frames[0]))
    with_frames(folder, band_frames(before, folder), 'frames = ["box.dng"]')
    if table:
        text = (folder / "capture.toml").read_text()
        text = re.sub(r'quantum_efficiency = (".*?")', r"quantum_efficiency = [\1, \1, \1]", text)
        (folder / "capture.toml").write_text(f'{text}\n[mosaic]\npattern = "{table}"\n')
    (note,) = file_mosaic_notes(load_capture(folder))
    assert "box.dng: the file states the mosaic RGGB" in note and phrases in note


def test_a_package_that_is_missing_for_many_frames_is_one_fault(folder, monkeypatch):
    before = load_capture(folder)
    names = [f"IMG_{k}.dng" for k in range(30)]
    for name in names:
        (folder / name).write_bytes(b"whatever")
    listed = ", ".join(f'"{name}"' for name in names)
    with_frames(folder, band_frames(before, folder), f"frames = [{listed}]")
    monkeypatch.setattr(frame_readers, "find_spec", lambda module: None)
    with pytest.raises(InputError) as refusal:
        load_capture(folder)
    message = str(refusal.value)
    assert message.count("pip install 'cboxlab[readers]'") == 1 and "\n" not in message and "IMG_0.dng" in message


def test_bands_in_one_file_are_no_frames(folder):
    before = load_capture(folder)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    stack = {name: np.full(before.shape, 5, np.float32) for name in ("a", "b")}
    OpenEXR.File(header, stack).write(str(folder / "a.exr"))
    with_frames(folder, band_frames(before, folder), 'frames = ["a.exr"]')
    with pytest.raises(InputError, match="the bands a, b in one file"):
        load_capture(folder)
