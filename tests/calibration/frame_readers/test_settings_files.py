"""Settings next to frames, PNG counts, and facts that programs write into FITS in their own way."""

from unicodedata import normalize

import cv2
import numpy as np
import pytest
from astropy.io import fits
from cboxlab.calibration.capture import write_first_manifest
from cboxlab.calibration.capture.file_facts import with_file_facts
from cboxlab.calibration.frame_readers import frame_header, read_pictures
from cboxlab.utils.errors import InputError

PICTURE = np.add.outer(np.arange(16), 16 * np.arange(24)).astype(np.uint16) * 16


def save(path, counts=PICTURE, **cards):
    history = cards.pop("HISTORY", [])
    unit = fits.PrimaryHDU(counts)
    for key, value in cards.items():
        unit.header[key] = value
    for line in history:
        unit.header["HISTORY"] = line
    unit.writeto(path)
    return path


@pytest.mark.parametrize(
    ("name", "text", "exposure_s", "filter_name"),
    [
        (
            "a_00001.CameraSettings.txt",
            "[ZWO]\nExposure=315.0000ms\nFilterWheel=f450\nFrameType=Light\n",
            0.315,
            "f450",
        ),
        ("a.txt", "Filter=R\nShutter=728.0ms\n", 0.728, "R"),
        ("a_00001.txt", "Exposure = 1.5s\nFilter=None\n", 1.5, None),
        ("a_00001.txt", "Exposure=1.5\n", None, None),  # no unit
        ("b.txt", "Exposure=1.5s\n", None, None),  # of another frame
    ],
)
def test_settings_next_to_a_frame_complete_its_facts(tmp_path, name, text, exposure_s, filter_name):
    path = save(tmp_path / "a_00001.fits")
    (tmp_path / name).write_text(text)
    facts = frame_header(path).facts
    assert (facts.exposure_s, facts.filter) == (exposure_s and pytest.approx(exposure_s), filter_name)


def test_the_frame_comes_before_its_settings(tmp_path):
    path = save(tmp_path / "a.fits", EXPTIME=2.0)
    (tmp_path / "a.txt").write_text("Exposure=1.5s\nFilter=R\n")
    assert (frame_header(path).facts.exposure_s, frame_header(path).facts.filter) == (2.0, "R")


def test_png_holds_counts_of_16_bits_alone(tmp_path):
    path = tmp_path / "f550_20ms_1.png"
    cv2.imwrite(str(path), PICTURE)
    assert np.array_equal(read_pictures(path), PICTURE[None])
    cv2.imwrite(str(tmp_path / "plot.png"), np.zeros((16, 24, 3), np.uint8))
    with pytest.raises(InputError, match="8 bits"):
        frame_header(tmp_path / "plot.png")
    first = write_first_manifest(tmp_path)
    assert [item.file for item in first.left_out] == ["plot.png"]


@pytest.mark.parametrize(
    ("text", "seconds"), [("1/60", 1 / 60), ("0,04 s", 0.04), ("2", 2.0), ("bulb", None), ("1/0", None), ("1-60", None)]
)
def test_a_text_of_seconds(tmp_path, text, seconds):
    facts = frame_header(save(tmp_path / "a.fits", EXPTIME=text)).facts
    assert facts.exposure_s == (None if seconds is None else pytest.approx(seconds, rel=1e-12))


@pytest.mark.parametrize(
    ("line", "letters"),
    [
        ("AstroImageJ: dark corrected with mdark.fits", "D"),
        ("flat corrected with mflat.fits", "F"),
        ("Subtracted master dark; divided by flat", "DF"),
        ("no dark taken, flat lamp on", ""),
    ],
)
def test_corrections_in_lines_of_history(tmp_path, line, letters):
    assert frame_header(save(tmp_path / "a.fits", HISTORY=[line])).facts.corrected == letters


def test_name_and_header_that_contradict_are_named(tmp_path):
    save(tmp_path / "light_550nm_500ms.fits", FILTER="650nm", EXPTIME=5.0)
    save(tmp_path / "light_450nm_500ms.fits", PICTURE + 1, FILTER="450nm", EXPTIME=0.45)
    notes = " ".join(str(key) for key in write_first_manifest(tmp_path).missing)
    assert "the filter f550 and its header 650nm" in notes and "0.5 s and its header 5 s" in notes
    assert "f450 and" not in notes and "0.45 s" not in notes


def test_numbers_of_a_camera_count_repeats_of_one_picture(tmp_path):
    """Of names that differ by a date and a number, those of one picture are repeats; another picture is none."""
    rng = np.random.default_rng(3)
    for k in range(4):
        light = PICTURE.astype(float) * (2 if k == 3 else 1)
        counts = (light + rng.normal(0, 5, light.shape)).clip(0).astype(np.uint16)
        save(tmp_path / f"cam_20261103_10451{k}345_000{k + 1}.fits", counts)
    assert write_first_manifest(tmp_path).tables == {"band": 2}


def test_letters_composed_in_two_ways_are_the_same_name(tmp_path):
    """A Mac's files have ü as u and two dots; names in a manifest, and of flats, have one letter."""
    composed, apart = (normalize(form, "Küche-Grün") for form in ("NFC", "NFD"))
    save(tmp_path / f"{apart}.fits", EXPTIME=1.0)
    save(tmp_path / f"flat-{composed}.fits", PICTURE + 1, EXPTIME=1.0)
    assert write_first_manifest(tmp_path).tables == {"band": 1, "flat": 1}
    frames = [{"frames": [f"{composed}.fits"], "id": "a"}]
    assert with_file_facts(tmp_path, {"band": frames})["band"][0]["frames"] == [f"{apart}.fits"]
