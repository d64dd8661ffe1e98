"""Frames in subfolders, and words of other languages, in a first manifest."""

import tomllib

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture.first_manifest import write_first_manifest
from cboxlab.utils.errors import InputError


def tiffs(folder, *names):
    noise = np.random.default_rng(3)
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        tifffile.imwrite(folder / f"{name}.tif", noise.integers(0, 4095, (12, 16)).astype(np.uint16))


def written(folder):
    first = write_first_manifest(folder)
    return tomllib.loads((folder / "capture.toml").read_text(encoding="utf-8")), first


def test_folders_say_what_frames_in_them_are(tmp_path):
    """By kind, filter or exposure; two folders may hold files of one name."""
    names = ("f550/0", "f550/1", "600nm/0", "darks/4s/0", "flats/f550/0", "flats/f550/1", "lights/f700")
    tiffs(tmp_path, *names)
    manifest, first = written(tmp_path)
    assert not first.left_out
    listed = [frame for kind in ("band", "dark", "flat") for t in manifest[kind] for frame in t["frames"]]
    listed += [frame for t in manifest.get("bracket", []) for frame in t["frames"]]
    assert sorted(listed) == sorted(f"{name}.tif" for name in names)
    assert {t["id"] for t in manifest["band"]} == {"f550", "f600", "f700"}
    assert [(t["exposure_s"], t["frames"]) for t in manifest["dark"]] == [(4.0, ["darks/4s/0.tif"])]
    assert [t["band"] for t in manifest["flat"]] == ["f550"]


def test_other_folders_are_named(tmp_path):
    """Numbers of photographs are no filters."""
    tiffs(tmp_path, "550/0", "darkroom/0")
    with pytest.raises(InputError, match="frames in the subfolders 550/, darkroom/ alone"):
        write_first_manifest(tmp_path)


def test_folders_of_dates_and_cameras_are_read(tmp_path):
    """They say nothing of a frame; repeats of several sessions are named."""
    names = ("2026-11-02/LIGHT/f550_2 min", "02.11.2026/LIGHT/f550_2 min", "DCIM/100CANON/f600_1s", "night 2/DARK/1s")
    tiffs(tmp_path, *names, "rejected/f550_2 min")
    manifest, first = written(tmp_path)
    assert {t["id"]: (len(t["frames"]), t["exposure_s"]) for t in manifest["band"]} == {
        "f550": (2, 120),
        "f600": (1, 1),
    }
    assert [t["frames"] for t in manifest["dark"]] == [["night 2/DARK/1s.tif"]]
    assert [item.file for item in first.left_out] == ["rejected/"]
    notes = [key.why for key in first.missing if "are repeats in it" in key.why]
    assert len(notes) == 1 and "02.11.2026" in notes[0] and "2026-11-02" in notes[0]


def test_a_folder_whose_name_distinguishes_nothing_is_read(tmp_path):
    tiffs(tmp_path, "Autorun/Light/My box/f550_1s", "Autorun/Dark/dark_1s")
    manifest, first = written(tmp_path)
    assert (len(manifest["band"]), len(manifest["dark"]), first.left_out) == (1, 1, ())


def test_dark_words_of_other_languages_need_a_dark_picture(tmp_path):
    size = (96, 96)
    noise = np.random.default_rng(5)
    slope = np.linspace(300, 3000, size[0])[:, None] * np.ones(size)
    for name, light in (("box_4s", slope), ("noir_4s", 100), ("buio_2s", 100), ("black_f550_4s", slope)):
        picture = noise.poisson(light, size).astype(np.uint16)
        tifffile.imwrite(tmp_path / f"{name}.tif", picture, photometric="minisblack")
    manifest, first = written(tmp_path)
    assert [t["frames"] for t in manifest["dark"]] == [["noir_4s.tif"]]
    assert [t["frames"] for t in manifest["band"]] == [["box_4s.tif"], ["black_f550_4s.tif"]]
    assert [(item.file, "'buio'" in item.why) for item in first.left_out] == [("buio_2s.tif", True)]


def test_a_flat_finds_its_filter_behind_the_word_light(tmp_path):
    tiffs(tmp_path, "Light_Ha_300_secs_001", "Flat_Ha_2.5_secs_001")
    manifest, first = written(tmp_path)
    assert not first.left_out and manifest["flat"][0]["band"] == manifest["band"][0]["id"]
