"""The loader of the capture format: what it accepts, and what it says about each mistake."""

import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture import band_channels, chosen_channel_notes, manifest
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.capture.manifest_faults import checked_keys
from cboxlab.scenes import PHYSICAL_LIMITS
from cboxlab.utils.errors import InputError
from helpers.fakes.capture import FakeCapture
from PIL import Image
from pydantic import BaseModel


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("captures") / "good"
    return FakeCapture(folder, centres=(450, 550, 650)).write()


@pytest.fixture
def folder(good, tmp_path):
    return shutil.copytree(good, tmp_path / "capture")


def edit(folder, old, new, count=1):
    path = folder / "capture.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))


def fault(folder) -> str:
    with pytest.raises(InputError) as caught:
        load_capture(folder)
    return str(caught.value)


def test_good_capture_is_read_as_written(folder):
    capture = load_capture(folder)
    assert capture.band_ids == ("f450", "f550", "f650")
    assert capture.shape == (40, 56) and capture.saturation_dn == 4095
    assert capture.frames(capture.manifest.band[0]).shape == (2, 40, 56)
    assert capture.manifest.camera.readout_s == 1.2


def test_every_key_of_the_format_is_accepted(folder):
    Image.fromarray(np.zeros((40, 56), np.uint8)).save(folder / "labels.png")
    (folder / "names.csv").write_text("label,name,column\n1,paper,\n2,white,w\n")
    (folder / "known.csv").write_text("wavelength_nm,w\n400,0.9\n700,0.9\n")
    (folder / "points.csv").write_text("id,x_mm,y_mm,z_mm,u_px,v_px\n")
    edit(folder, 'name = "fake"', 'name = "fake"\nscene = "cornell-box"')
    edit(folder, "[camera]", '[camera]\nmodel = "fake"\nreadout_s = 0.5')
    column = '"spectra/all.csv:quantum_efficiency"'
    edit(folder, f"quantum_efficiency = {column}", f"quantum_efficiency = [{column}, {column}, {column}]")
    edit(
        folder, '[[flat]]\nband = "f450"', '[[flat]]\nband = "f450"\nstart_s = 3.5\nradiance = "spectra/all.csv:sphere"'
    )
    with open(folder / "capture.toml", "a") as stream:
        stream.write(
            '[lamp]\nradiance = "spectra/all.csv:sphere"\nrelative_uncertainty = 0.02\n'
            "spectral_uncertainty = 0.01\n"
            '[geometry]\npoints = "points.csv"\npoint_sigma_px = 0.15\n'
            '[[target]]\nkind = "charuco"\nrows = 5\ncolumns = 6\npitch_mm = 8\n'
            'frames = ["frames/f450-0.tif"]\n'
            '[mosaic]\npattern = "GBRG"\n'
            '[[bracket]]\nband = "f450"\nexposure_s = 0.1\nframes = ["frames/f450-1.tif"]\n'
            '[labels]\nimage = "labels.png"\nnames = "names.csv"\nreflectance = "known.csv"\n'
            "[crop]\nu0_px = 4\nv0_px = 2\nfull_width_px = 60\nfull_height_px = 42\n"
        )
    capture = load_capture(folder)
    bracket = capture.brackets("f450")[0]
    assert capture.f_number(bracket) == 8.0 and capture.image_distance_mm(bracket) == 36.6
    assert capture.quantum_efficiency("G") is not None
    assert [label.column for label in capture.label_names()] == [None, "w"]
    assert capture.manifest.flats[0].start_s == 3.5
    assert capture.manifest.lamp.spectral_uncertainty == 0.01


@pytest.mark.parametrize("name", ["baseline", "mystery-1", "mystery-2", "mystery-3"])
def test_shared_captures_load(shared, name):
    capture = load_capture(shared / "captures" / name)
    assert len(capture.band_ids) == 7


@pytest.mark.parametrize("name", ["seven-band-colorchecker", "seven-band-disks"])
def test_real_captures_load(shared, name):
    assert load_capture(shared / "real" / name).manifest.mosaic.pattern == "GBRG"


def test_missing_folder_and_manifest(tmp_path):
    assert "no such folder" in fault(tmp_path / "nowhere")
    assert "capture.toml" in fault(tmp_path)


COLUMN = '"spectra/all.csv:quantum_efficiency"'
QE = f"quantum_efficiency = {COLUMN}\n"
QE_TABLE = f"quantum_efficiency = {{R = {COLUMN}, G = {COLUMN}}}\n"
QE_LIST = f"quantum_efficiency = [{COLUMN}, {COLUMN}, {COLUMN}]\n"

# old text, new text, words that the message must hold: where, what, and how to mend it
MISTAKES = [
    ('format = "capture/1"', 'format = "capture/9"', ["format", "capture/9", "'capture/1'"]),
    ("exposure_s", "expsure_s", ["band[0] (f450).expsure_s", "unknown key", "Did you mean 'exposure_s'?"]),
    ("bit_depth = 12\n", "", ["camera.bit_depth", "nothing"]),
    ("bit_depth = 12", "bit_depth = 17", ["camera.bit_depth", "17", "16"]),
    ("bit_depth = 12", "bit_depth = 12.5", ["camera.bit_depth", "12.5", "a whole number"]),
    ("width_px = 56", 'width_px = "56"', ["camera.width_px", "'56'"]),
    ('[[flat]]\nband = "f550"', '[[flat]]\nband = "f555"', ["flat[1].band", "f555", "Did you mean 'f550'"]),
    ('[[reference]]\nband = "f650"', '[[reference]]\nband = "x"', ["reference[2].band", "'x'"]),
    ('[[flat]]\nband = "f550"', '[[flat]]\nbnd = "f550"', ["flat[1].bnd", "Did you mean 'band'?"]),
    ('["frames/f450-0.tif"', '["../f450-0.tif"', ["band[0] (f450).frames[0]", "../f450-0.tif", "stays"]),
    ('["frames/f450-0.tif"', '["/tmp/f450-0.tif"', ["band[0] (f450).frames[0]", "stays in the folder"]),
    ('["frames/f450-0.tif"', '["frames/f450-1.tif"', ["band[0] (f450).frames", "listed once"]),
    ('["frames/f450-0.tif"', '["frames/f459-0.tif"', ["band[0].frames", "f459-0.tif", "does not exist"]),
    ('["frames/f450-0.tif"', '["Frames/F450-0.TIF"', ["does not exist", "Did you mean 'frames/f450-0.tif'?"]),
    ("width_px = 56", "width_px = 57", ["f450-0.tif and ", " others: found 56 x ", "expected 57 x "]),
    ("f_number = 8.0", "f_number = 2024-05-12", ["band[0] (f450).f_number", "a date or time, 2024-05-12", "number"]),
    (QE, QE_LIST.replace(f"{COLUMN}, ", "", 1), ["camera.quantum_efficiency", "a list of 2", "at least 3"]),
    ('"spectra/all.csv:f450"', '"spectra/all.csv:f45"', ["transmittance", "'f45'", "Did you mean 'f450'"]),
    ('"spectra/all.csv:f450"', '"spectra/all.csv"', ["transmittance", "file.csv:column"]),
    ('"spectra/all.csv:f450"', '"../all.csv:f450"', ["transmittance", "stays in the folder"]),
    ("f_number = 8.0", "f_number = -8.0", ["band[0] (f450).f_number", "-8.0", "above 0"]),
    ("f_number = 8.0", "f_number = nan", ["band[0] (f450).f_number", "nan", "finite"]),
    ("f_number = 8.0", "f_number = true", ["band[0] (f450).f_number", "True", "number"]),
    ("[lens]", "[lense]", ["lense", "unknown key", "Did you mean 'lens'?"]),
    ('name = "fake"', 'name = "fake', ["TOML"]),
    ('name = "fake"', 'name = "fake"\nflat = "divided"', ["flat", "both", "[[flat]]"]),
    ('name = "fake"', 'name = "fake"\ndark = "subtracted"', ["dark", "both", "[[dark]]"]),
    ("[lens]", "[crop]\nu0_px=9\nv0_px=0\nfull_width_px=60\nfull_height_px=99\n[lens]", ["crop", "65 px"]),
    ("[camera]", '[mosaic]\npattern = "RG1B"\n[camera]', ["mosaic.pattern", "RG1B", "four letters"]),
    ('id = "f550"', 'id = "f550"\nchannel = "R"', ["band[1] (f550).channel", "'R'", "A channel needs [mosaic]."]),
    (QE, QE_TABLE, ["camera.quantum_efficiency", "a table", "needs [mosaic]"]),
    (QE, f'{QE_TABLE}\n[mosaic]\npattern = "RGGB"\n', ["quantum_efficiency", "R, G", "R, G, B"]),
    (QE, f'{QE_LIST}\n[mosaic]\npattern = "RGBW"\n', ["quantum_efficiency", "stands for R, G, B", "R, G, B, W"]),
    ("[camera]", '[mosaic]\npattern = "RGGB"\n[camera]', ["quantum_efficiency", "list of three"]),
    ("[camera]", '[geometry]\npoints = "points.csv"\n[camera]', ["geometry.points", "does not exist"]),
]


@pytest.mark.parametrize(("old", "new", "phrases"), MISTAKES, ids=[m[1][:40] or m[0] for m in MISTAKES])
def test_each_mistake_is_named_in_one_line(folder, old, new, phrases):
    edit(folder, old, new)
    message = fault(folder)
    assert "\n" not in message
    for word in [*phrases, "capture.toml" if "frames/" not in phrases[0] else "tif", "expected"]:
        assert word in message


@pytest.mark.parametrize("channel", ["W", "G3", "R2", "GG"])
def test_a_channel_that_the_mosaic_lacks(folder, channel):
    edit(folder, QE, QE_LIST)
    edit(folder, 'id = "f550"', f'id = "f550"\nchannel = "{channel}"')
    edit(folder, "[lens]", '[mosaic]\npattern = "RGGB"\n[lens]')
    message = fault(folder)
    assert "band[1] (f550).channel" in message and f"'{channel}'" in message and "R, G, B" in message


def test_stated_channels_and_a_table_of_efficiencies(folder):
    table = f"quantum_efficiency = {{R = {COLUMN}, G = {COLUMN}, W = {COLUMN}}}\n"
    edit(folder, QE, table)
    edit(folder, 'id = "f450"', 'id = "f450"\nchannel = "W"')
    edit(folder, 'id = "f550"', 'id = "f550"\nchannel = "G2"')
    edit(folder, "[lens]", '[mosaic]\npattern = "RGGW"\n[lens]')
    capture = load_capture(folder)
    channels = band_channels(capture)
    assert channels == {"f450": "W", "f550": "G2", "f650": "R"}  # without a key: the first of equal responses
    assert capture.quantum_efficiency("G2") is not None and capture.quantum_efficiency("W") is not None
    assert capture.cell == (2, 2)
    selected, further = chosen_channel_notes(capture, channels)
    assert "f650 R" in selected and "f450" not in selected
    assert "f650" in further and "f450" not in further


def test_wrong_size_of_all_frames_is_cut_short(folder):
    edit(folder, "width_px = 56", "width_px = 57")
    message = fault(folder)
    assert "f450-0.tif" in message and "56 x 40" in message and "57 x 40" in message
    assert message.count("\n") <= 21


def test_band_that_stands_twice(folder):
    edit(folder, 'id = "f550"', 'id = "f450"')
    message = fault(folder)
    assert "band[1].id" in message and "a second time" in message
    assert "flat[1].band" in message  # whose band is now gone


@pytest.mark.parametrize("value", ["-1.0", "0", "inf"])
def test_exposures_are_positive_and_finite(folder, value):
    path = folder / "capture.toml"
    lines = path.read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("exposure_s"))
    path.write_text("\n".join([*lines[:first], f"exposure_s = {value}", *lines[first + 1 :]]))
    assert "band[0] (f450).exposure_s" in fault(folder)


def test_band_without_exposure(folder):
    path = folder / "capture.toml"
    lines = path.read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("exposure_s"))
    path.write_text("\n".join(lines[:first] + lines[first + 1 :]))
    message = fault(folder)
    assert "band[0] (f450).exposure_s" in message and "nothing" in message


def test_all_faults_are_named_in_one_pass(folder):
    edit(folder, "bit_depth = 12", "bit_depth = 0")
    edit(folder, "f_number = 8.0", "f_numbr = 8.0")
    edit(folder, 'id = "f550"', 'id = ""')
    message = fault(folder)
    assert "3 faults" in message
    assert all(key in message for key in ("camera.bit_depth", "f_numbr", "band[1].id"))
    assert message.count("\n") == 3


def test_numbers_that_no_laboratory_has_are_refused_with_the_possible_ones():
    """Other units, mistyped zeros and dates in place of seconds; one table holds all limits."""
    camera = {"width_px": 64, "height_px": 64, "bit_depth": 12}
    band = {"id": "a", "frames": ["a.tif"], "exposure_s": 1.0, "f_number": 8.0}
    sound = {"format": "capture/1", "camera": camera, "band": [band]}
    assert checked_keys(Path("c.toml"), sound)[1] == []
    for table, key, value, possible in (
        ("camera", "pixel_pitch_um", 1953125.0, "0.05 to 20000 um"),
        ("camera", "gain_e_per_dn", 1e300, "0.0001 to 1e+06 e-/DN"),
        ("camera", "black_level_dn", {"R": 512.0, "G": 1e9, "B": 512.0}, "0 to 65535 DN"),
        ("camera", "width_px", 10**9, "1 to 1.04858e+06 px"),
        ("band", "f_number", 1e-9, "0.1 to 5000"),
        ("band", "exposure_s", 1.8e12, "1e-09 to 1e+06 s"),
        ("band", "start_s", -1.8e12, "-1e+10 to 1e+10 s"),
        ("lens", "focal_length_mm", 3.5e7, "0.1 to 100000 mm"),
        ("lens", "distortion", [0.1, -1e300, 0.0, 0.0, 0.0], "-10000 to 10000"),
    ):
        content = {"camera": {**camera}, "band": {**band}, "lens": {}}
        content[table][key] = value
        data = {**sound, "camera": content["camera"], "band": [content["band"]], "lens": content["lens"]}
        (error,) = checked_keys(Path("c.toml"), data)[1]
        assert key in error.where and error.expected.startswith(f"{possible}:")


def test_every_number_of_the_manifest_has_limits():
    """But for bits, which are a choice, and unit vectors, whose length is checked."""
    tables = [model for model in vars(manifest).values() if isinstance(model, type) and issubclass(model, BaseModel)]
    numbers = {
        key
        for table in tables
        for key, field in table.model_fields.items()
        if re.search(r"\b(int|float)\b", str(field.annotation))
    }
    assert len(numbers) > 25 and numbers - {*PHYSICAL_LIMITS} == {"bit_depth", "right", "down"}


def test_all_faulty_files_are_named_in_one_pass(folder):
    (folder / "frames" / "f450-0.tif").unlink()
    (folder / "frames" / "f550-0.tif").write_bytes(b"no TIFF at all")
    message = fault(folder)
    assert "f450-0.tif" in message and "f550-0.tif" in message and message.count("\n") == 2


@pytest.mark.parametrize(
    ("old", "new", "key", "expected"),
    [
        ("bit_depth = 12", "bit_depth = true", "camera.bit_depth", "a whole number"),
        ("[camera]", "[[camera]]", "camera", "one table, [camera]"),
        ("[camera]", "bracket = [3]\n[camera]", "bracket[0]", "tables in double brackets, [[bracket]]"),
        ("bit_depth = 12", "bit_depth = 12\nbit_depth = 12", "line", "This name stands in the file before"),
        ('frames = ["frames/f450-0.tif"', 'frames = [3, "frames/f450-0.tif"', "frames[0]", "text in quotes"),
        ("exposure_s = ", "frames = []\nexposure_s = ", "line", "This name stands in the file before"),
    ],
)
def test_faults_are_reported_in_the_authors_words(folder, old, new, key, expected):
    edit(folder, old, new)
    message = fault(folder)
    assert key in message and expected in message and "tuple" not in message and "dictionary" not in message


@pytest.mark.parametrize(
    ("begin", "kind"),
    [(b"", "empty"), (b"\x89PNG\r\n\x1a\n", "PNG"), (b"SIMPLE  =  T", "FITS"), (b"\x1f\x8b\x08", "gzip")],
)
def test_frames_of_another_kind_are_called_that(folder, begin, kind):
    (folder / "frames" / "f550-0.tif").write_bytes(begin)
    message = fault(folder)
    assert "f550-0.tif" in message and kind in message and "damaged" not in message


@pytest.mark.parametrize(("make", "kind"), [(os.mkdir, "a folder"), (os.mkfifo, "a pipe")])
def test_what_stands_in_place_of_a_frame_is_named(folder, make, kind):
    (folder / "frames" / "f550-0.tif").unlink()
    make(folder / "frames" / "f550-0.tif")
    assert f"'frames/f550-0.tif', which is {kind}" in fault(folder)


def test_truncated_frame(folder):
    path = folder / "frames" / "f550-1.tif"
    path.write_bytes(path.read_bytes()[:-500])
    message = fault(folder)
    assert "f550-1.tif" in message and "truncated" in message and "\n" not in message


def test_damaged_compressed_pixels_are_found_when_read(folder):
    path = folder / "frames" / "f550-1.tif"
    tifffile.imwrite(path, tifffile.imread(path), compression="zlib")
    content = bytearray(path.read_bytes())
    content[-400:] = bytes(400)
    path.write_bytes(bytes(content))
    with pytest.raises(InputError, match="f550-1"):
        load_capture(folder).frame("frames/f550-1.tif")


@pytest.mark.parametrize(
    ("pixels", "word"),
    [
        (np.zeros((40, 56), np.uint8), "uint8"),
        (np.zeros((40, 56), np.float32), "floating-point values"),
        (np.zeros((40, 56, 3), np.uint16), "one channel"),
        (np.zeros((56, 40), np.uint16), "40 x 56"),
    ],
    ids=["8 bit", "floating point", "colour", "turned"],
)
def test_frames_of_a_wrong_kind(folder, pixels, word):
    kind = "rgb" if pixels.ndim == 3 and pixels.shape[-1] == 3 else "minisblack"
    tifffile.imwrite(folder / "frames" / "f450-0.tif", pixels, photometric=kind)
    message = fault(folder)
    assert "f450-0.tif" in message and word in message


def test_counts_beyond_the_bit_depth(folder):
    frame = np.full((40, 56), 4096, np.uint16)
    tifffile.imwrite(folder / "frames" / "f450-0.tif", frame)
    with pytest.raises(InputError, match=r"f450-0.*4096.*4095.*bit_depth"):
        load_capture(folder).frame("frames/f450-0.tif")


def test_not_a_number_in_a_spectrum(folder):
    path = folder / "spectra" / "all.csv"
    lines = path.read_text().splitlines()
    lines[5] = lines[5].replace(lines[5].split(",")[2], "nan")
    path.write_text("\n".join(lines))
    message = fault(folder)
    assert "all.csv" in message and "line 6" in message and "lens" in message and "\n" not in message


def test_link_out_of_the_folder(folder, tmp_path):
    path = folder / "frames" / "f450-0.tif"
    path.rename(tmp_path / "outside.tif")
    os.symlink(tmp_path / "outside.tif", path)
    assert "leaves the folder" in fault(folder)


def test_corrected_frames_need_no_darks_or_flats(tmp_path):
    folder = FakeCapture(tmp_path / "c", centres=(550,)).write(darks=False, flats=False)
    edit(folder, 'name = "fake"', 'name = "fake"\ndark = "subtracted"\nflat = "divided"')
    manifest = load_capture(folder).manifest
    assert manifest.darks == () and manifest.flats == ()
    edit(folder, '"subtracted"', '"substracted"')
    assert "substracted" in fault(folder)


def test_label_table_and_image_are_checked(folder):
    Image.fromarray(np.zeros((41, 56), np.uint8)).save(folder / "labels.png")
    (folder / "names.csv").write_text("label,title\n1,paper\n")
    with open(folder / "capture.toml", "a") as stream:
        stream.write('[labels]\nimage = "labels.png"\nnames = "names.csv"\n')
    message = fault(folder)
    assert "56 x 41" in message and "56 x 40" in message and "name, column" in message
