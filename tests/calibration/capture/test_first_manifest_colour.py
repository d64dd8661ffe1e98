"""The first manifest of a colour camera: bands by channel, repeats by what they show, common values once."""

import tomllib

import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.capture.first_manifest import write_first_manifest
from helpers.files.frame_files import write_dng, write_fits

SHAPE = (64, 96)
#: The darkest to the brightest part of the scene, DN.
SCENE = np.linspace(100, 3000, SHAPE[1]) * np.linspace(1, 0.3, SHAPE[0])[:, None]


def photograph(seed, factor=1.0):
    return np.random.default_rng(seed).poisson(SCENE * factor).astype(np.uint16)


def written(folder):
    first = write_first_manifest(folder)
    with (folder / "capture.toml").open("rb") as file:
        return tomllib.load(file), first


def test_a_folder_of_raw_files_loads_as_it_is_written(tmp_path):
    """Four numbered photographs and darks of one exposure become three bands of four repeats, with nothing to add."""
    for number in range(4):
        write_dng(tmp_path / f"IMG_{number + 10:04d}.dng", photograph(number))
        write_dng(
            tmp_path / f"dark-{number}.dng", np.random.default_rng(9 + number).poisson(3, SHAPE).astype(np.uint16)
        )
    rows = "\n".join(f"{nm},{abs(nm - 650)},{abs(nm - 550)},{abs(nm - 450)}" for nm in range(400, 701, 50))
    (tmp_path / "channels.csv").write_text(f"wavelength_nm,r,g,b\n{rows}\n".replace("650,0", "650,1"))
    manifest, first = written(tmp_path)
    assert not [key for key in first.missing if key.required] and not first.left_out
    frames = [f"IMG_{number + 10:04d}.dng" for number in range(4)]
    assert manifest["band"] == [{"id": f"IMG_0010-{c}", "frames": frames, "channel": c} for c in "RGB"]
    assert manifest["defaults"] == {"exposure_s": 0.25, "f_number": 8.0} and manifest["scale"] == "free"
    assert manifest["camera"]["quantum_efficiency"] == {c: f"channels.csv:{c.lower()}" for c in "RGB"}
    capture = load_capture(tmp_path)
    assert [band.channel for band in capture.manifest.band] == ["R", "G", "B"]
    assert {band.f_number for band in capture.manifest.band} == {8.0}


@pytest.mark.parametrize(
    ("second", "number", "count"),
    [
        (photograph(1), 11, 1),
        (photograph(1, 1.02), 11, 2),
        (photograph(1)[:, ::-1], 11, 2),
        (photograph(1), 12, 2),
    ],
    ids=["a repeat", "more light", "another scene", "a number between"],
)
def test_photographs_that_show_the_same_are_repeats(second, number, count, tmp_path):
    """Means of 8 x 12 pixels agree to 0.3 %; light that is 2 % more is another measurement."""
    for stem, image in (("IMG_0010", photograph(0)), (f"IMG_{number:04d}", second)):
        write_fits(tmp_path / f"{stem}.fits", image, EXPTIME=0.5)
    manifest, _ = written(tmp_path)
    assert len(manifest["band"]) == count and sum(len(band["frames"]) for band in manifest["band"]) == 2


def test_a_filter_in_front_of_a_colour_sensor_is_one_band(tmp_path):
    write_dng(tmp_path / "f550-0.dng", photograph(0))
    write_dng(tmp_path / "flat-f550-0.dng", photograph(1))
    manifest, _ = written(tmp_path)
    assert [(band["id"], band.get("channel")) for band in manifest["band"]] == [("f550", None)]
    assert manifest["flat"][0]["band"] == "f550"


def test_references_claim_an_absolute_scale_and_other_values_stand_with_their_table(tmp_path):
    for seed, (name, exposure) in enumerate((("f450", 0.5), ("f550", 1.0), ("sphere-f450", 0.5))):
        write_fits(tmp_path / f"{name}.fits", photograph(seed), EXPTIME=exposure)
    manifest, _ = written(tmp_path)
    assert "scale" not in manifest and "defaults" not in manifest
    assert [band["exposure_s"] for band in manifest["band"]] == [0.5, 1.0]
