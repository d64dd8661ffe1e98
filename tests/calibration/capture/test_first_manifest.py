"""Frames of other formats become a capture that loads; what nobody can know is asked for."""

import tomllib

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.capture.first_manifest import write_first_manifest
from cboxlab.utils.errors import InputError
from helpers.files.frame_files import write_dng, write_fits

SHAPE = (12, 16)


def completed(folder, **required):
    """The capture of a folder after the user has stated what was missing, as key='value'."""
    path = folder / "capture.toml"
    text = path.read_text()
    for key, value in required.items():
        assert f"# {key} = " in text
        text = text.replace(f"# {key} =  ", f"{key} = {value}")
    path.write_text(text)
    return load_capture(folder)


def required(first):
    return [f"{key.where} {key.example}" for key in first.missing if key.required]


def counts(seed):
    return np.random.default_rng(seed).integers(0, 4095, SHAPE).astype(np.uint16)


def test_a_folder_of_tiffs(tmp_path):
    for index, name in enumerate(
        [
            "f450_4s_0",
            "f450_4s_1",
            "f450_1s_0",
            "550nm-250ms-0",
            "dark-4s-0",
            "dark-4s-1",
            "flat-f450-1s",
            "sphere-f450-2s",
        ]
    ):
        tifffile.imwrite(tmp_path / f"{name}.tif", counts(index))
    first = write_first_manifest(tmp_path)
    assert first.tables == {"band": 2, "bracket": 1, "dark": 1, "flat": 1, "reference": 1}
    assert required(first) == [
        "[camera] bit_depth = 12",
        '[[reference]] of sphere-f450-2s.tif radiance = "spectra/sphere.csv:radiance"',
    ]
    with pytest.raises(InputError, match=r"(?s)camera\.bit_depth: found nothing.*reference\[0\] \(f450\)\.radiance"):
        load_capture(tmp_path)
    (tmp_path / "sphere.csv").write_text("wavelength_nm,radiance\n400,1\n700,1\n")
    capture = completed(tmp_path, bit_depth="12", radiance='"sphere.csv:radiance"')
    assert set(capture.band_ids) == {"f450", "f550"}
    assert capture.manifest.darks[0].exposure_s == 4.0 and len(capture.manifest.darks[0].frames) == 2
    assert capture.band("f550").exposure_s == 0.25
    assert {capture.band("f450").exposure_s, capture.brackets("f450")[0].exposure_s} == {4.0, 1.0}
    assert any(key.where == "[geometry]" and key.example == 'points = "points.csv"' for key in first.missing)


def test_a_folder_of_fits_becomes_a_capture(tmp_path):
    write_fits(tmp_path / "a.fits", counts(1), EXPTIME=2.0, FILTER="f550", IMAGETYP="LIGHT")
    write_fits(tmp_path / "b.fits", counts(2), EXPTIME=2.0, IMAGETYP="DARK")
    first = write_first_manifest(tmp_path)
    assert required(first) == ["[camera] bit_depth = 12"]
    capture = completed(tmp_path, bit_depth="12")
    np.testing.assert_array_equal(capture.frames(capture.band("f550"))[0], counts(1))
    np.testing.assert_array_equal(capture.frames(capture.manifest.darks[0])[0], counts(2))
    assert capture.band("f550").exposure_s == 2.0


def test_what_is_not_known_is_left_out_and_refused(tmp_path):
    """No exposure and no bit depth are written, and every key that is written is known."""
    tifffile.imwrite(tmp_path / "kitchen.tif", counts(1))
    first = write_first_manifest(tmp_path)
    assert required(first) == ["[camera] bit_depth = 12", "[[band]] of kitchen.tif exposure_s = 4.0"]
    assert any(key.where == "[[dark]]" for key in first.missing)
    with (tmp_path / "capture.toml").open("rb") as file:
        written = tomllib.load(file)
    assert written["camera"] == {"width_px": 16, "height_px": 12}
    assert written["band"] == [{"id": "kitchen", "frames": ["kitchen.tif"]}]
    with pytest.raises(InputError, match=r"(?s)bit_depth: found nothing.*exposure_s: found nothing.*exposure_s = 4.0"):
        load_capture(tmp_path)
    assert completed(tmp_path, bit_depth="12", exposure_s="0.5").band("kitchen").exposure_s == 0.5


def test_a_target_waits_for_its_print(tmp_path):
    tifffile.imwrite(tmp_path / "kitchen-1s.tif", counts(1))
    tifffile.imwrite(tmp_path / "chessboard-0.tif", counts(2))
    first = write_first_manifest(tmp_path)
    capture = completed(tmp_path, bit_depth="12", kind='"chessboard"', rows="6", columns="9", pitch_mm="25.0")
    assert first.tables["target"] == 1 and capture.manifest.target[0].pitch_mm == 25.0


def test_a_raw_files_white_level_is_its_bit_depth(tmp_path):
    write_dng(tmp_path / "a.dng", np.random.default_rng(2).integers(0, 4095, (48, 64)).astype(np.uint16))
    first = write_first_manifest(tmp_path)
    assert not required(first) and load_capture(tmp_path).manifest.camera.bit_depth == 12


def test_nothing_is_written_over(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", counts(1))
    write_first_manifest(tmp_path)
    with pytest.raises(InputError, match="exists already"):
        write_first_manifest(tmp_path)


def test_frames_of_two_sizes(tmp_path):
    for name in ("f450", "f550"):
        tifffile.imwrite(tmp_path / f"{name}.tif", counts(1))
    tifffile.imwrite(tmp_path / "f650.tif", counts(1)[:5])
    with pytest.raises(InputError, match=r"f650.tif.*16 x 5"):
        write_first_manifest(tmp_path)
    assert not (tmp_path / "capture.toml").exists()


def test_an_empty_folder(tmp_path):
    with pytest.raises(InputError, match="no frames"):
        write_first_manifest(tmp_path)
