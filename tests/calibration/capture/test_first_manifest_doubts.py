"""What the headers of FITS say in two ways, or of the counts, in a first manifest."""

import tomllib

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture.first_manifest import write_first_manifest
from helpers.files.frame_files import write_fits


def counts(seed):
    return np.random.default_rng(seed).integers(0, 4095, (12, 16)).astype(np.uint16)


def written(folder):
    first = write_first_manifest(folder)
    return tomllib.loads((folder / "capture.toml").read_text(encoding="utf-8")), first


def notes(first):
    return " ".join(map(str, first.missing))


def test_two_exposures_of_a_header_are_asked_for(tmp_path):
    for k in range(2):
        write_fits(tmp_path / f"f550-{k}.fits", counts(k), EXPTIME=4.0, EXPOSURE=40.0)
    write_fits(tmp_path / "f650-0.fits", counts(5), EXPTIME=4.0, EXPOSURE=4.01)
    manifest, first = written(tmp_path)
    assert {t["id"]: t.get("exposure_s") for t in manifest["band"]} == {"f550": None, "f650": 4.0}
    assert "f550-0.fits and 1 others: EXPTIME is 4 s and EXPOSURE 40 s" in notes(first)


def test_frames_that_a_program_corrected_are_stated_so(tmp_path):
    """MaxIm DL joins number and filter, and writes CALSTAT and PEDESTAL."""
    for k, band in enumerate(("f450", "H-alpha", "f450", "H-alpha")):
        header = {"FILTER": band, "EXPTIME": 4.0, "CALSTAT": "BDF", "PEDESTAL": -100}
        write_fits(tmp_path / f"box-00{1 + k // 2}{band}.fits", counts(k), **header)
    manifest, first = written(tmp_path)
    assert (manifest["dark"], manifest["flat"]) == ("subtracted", "divided")
    assert {t["id"]: len(t["frames"]) for t in manifest["band"]} == {"f450": 2, "H-alpha": 2}
    assert "without light the frames show 100 DN" in notes(first) and "no frames found; without" not in notes(first)


def test_a_frame_of_another_gain_is_no_repeat(tmp_path):
    for k, gain in enumerate((1.0, 1.0, 0.5)):
        write_fits(tmp_path / f"f550-1s-{k}.fits", counts(k), EGAIN=gain)
    manifest, first = written(tmp_path)
    assert manifest["band"][0]["frames"] == ["f550-1s-0.fits", "f550-1s-1.fits"]
    assert [item.file for item in first.left_out] == ["f550-1s-2.fits"]


@pytest.mark.parametrize("is_set_back", [False, True])
def test_a_clock_that_was_set_back_is_noted(tmp_path, is_set_back):
    for k, moment in enumerate(("02:59:30", "02:59:50", "02:00:10" if is_set_back else "03:00:10")):
        band = "f450" if k < 2 else "f550"
        write_fits(tmp_path / f"{band}_{k + 1:03}.fits", counts(k), EXPTIME=1.0, **{"DATE-OBS": f"2026-10-25T{moment}"})
    assert ("f550_003.fits states an earlier time" in notes(written(tmp_path)[1])) == is_set_back


@pytest.mark.parametrize(("dark_s", "is_noted"), [("2", True), ("4", False)])
def test_a_missing_dark_exposure_and_shifted_bits_are_noted(tmp_path, dark_s, is_noted):
    for k, name in enumerate(("f550-4s-0", f"dark-{dark_s}s-0")):
        tifffile.imwrite(tmp_path / f"{name}.tif", (counts(k) << 4 if is_noted else counts(k)).astype(np.uint16))
    text = notes(written(tmp_path)[1])
    assert ("no dark of 4 s" in text) == ("multiples of 16" in text) == is_noted


def test_no_filter_is_none(tmp_path):
    write_fits(tmp_path / "box.fits", counts(1), EXPTIME=1.0, FILTER="None", BAYERPAT="RGGB")
    assert [t["channel"] for t in written(tmp_path)[0]["band"]] == ["R", "G", "B"]
