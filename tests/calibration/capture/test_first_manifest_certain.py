"""A first manifest states nothing that is not certain, and names every file it leaves out."""

import os
import tomllib

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.capture.first_manifest import write_first_manifest
from cboxlab.utils.errors import InputError
from helpers.files.frame_files import XTRANS, shifted, write_dng, write_fits
from PIL import Image

SHAPE = (12, 16)


def counts(seed):
    return np.random.default_rng(seed).integers(0, 4095, SHAPE).astype(np.uint16)


def tiffs(folder, *names):
    for seed, name in enumerate(names):
        (folder / name).parent.mkdir(exist_ok=True)
        tifffile.imwrite(folder / f"{name}.tif", counts(seed))


def written(folder):
    first = write_first_manifest(folder)
    with (folder / "capture.toml").open("rb") as file:
        return tomllib.load(file), first


def frames(manifest):
    tables = [
        table for key in ("band", "bracket", "dark", "flat", "reference", "target") for table in manifest.get(key, [])
    ]
    return [frame for table in tables for frame in table["frames"]]


def bands(manifest):
    return {table["id"]: table["frames"] for table in manifest["band"]}


# Kind, band, exposure and repeat only where they are certain


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("IMG_0550", "IMG_0551"), {"IMG_0550": ["IMG_0550.tif"], "IMG_0551": ["IMG_0551.tif"]}),
        (("DSC00450", "P1010550"), {"DSC00450": ["DSC00450.tif"], "P1010550": ["P1010550.tif"]}),
        (("100_0550", "100_0551"), {"100_0550": ["100_0550.tif"], "100_0551": ["100_0551.tif"]}),
        (("550", "551", "552"), {"550": ["550.tif"], "551": ["551.tif"], "552": ["552.tif"]}),
        (("box-0", "box-1"), {"box": ["box-0.tif", "box-1.tif"]}),
        (("box-3", "box-7"), {"box-3": ["box-3.tif"], "box-7": ["box-7.tif"]}),
        (("open-1", "open-2", "open-10"), {f"open-{k}": [f"open-{k}.tif"] for k in (1, 2, 10)}),
        (("f550-1s-1", "f550-1s-2", "f550-1s-10"), {"f550": [f"f550-1s-{k}.tif" for k in (1, 2, 10)]}),
        (("lampon-f550-1s", "lampoff-f550-1s"), {f"{k}-f550": [f"{k}-f550-1s.tif"] for k in ("lampon", "lampoff")}),
        (("box-f450", "box-f550"), {"f450": ["box-f450.tif"], "f550": ["box-f550.tif"]}),
    ],
)
def test_bands_and_repeats(tmp_path, names, expected):
    tiffs(tmp_path, *names)
    manifest, _ = written(tmp_path)
    assert bands(manifest) == expected and "bracket" not in manifest


def test_frames_of_unknown_exposures_are_no_repeats(tmp_path):
    """1/30 s and 1/60 s, or 30 s and 60 s: not the same exposure in any reading."""
    tiffs(tmp_path, "f450_1-30s", "f450_1-60s")
    manifest, first = written(tmp_path)
    assert [table["frames"] for table in (*manifest["band"], *manifest["bracket"])] == [
        ["f450_1-30s.tif"],
        ["f450_1-60s.tif"],
    ]
    questions = [key.why for key in first.missing if key.required and key.key == "exposure_s"]
    assert [f"'1-{k}0s' in the name may be it" in why for k, why in zip((3, 6), questions, strict=True)] == [True] * 2


def test_repeats_of_other_exposures_in_the_header_are_bands_of_their_names(tmp_path):
    for k, exposure in enumerate((1.0, 2.0)):
        write_fits(tmp_path / f"box-{k}.fits", counts(k), EXPTIME=exposure)
    assert set(bands(written(tmp_path)[0])) == {"box-0", "box-1"}


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("dark-room-f550-1s", "room"),
        ("flat-white-f550-1s", "white"),
        ("reference-box-1s", "box"),
        ("box-dark-1s", "dark"),
        ("dark-flat-1s", "flat"),
        ("target-wall-f550", "wall"),
    ],
)
def test_an_uncertain_kind_is_named_and_left_out(tmp_path, name, word):
    tiffs(tmp_path, "f450-1s", name)
    manifest, first = written(tmp_path)
    assert frames(manifest) == ["f450-1s.tif"]
    assert [item.file for item in first.left_out] == [f"{name}.tif"] and word in first.left_out[0].why


@pytest.mark.parametrize(
    ("name", "header", "table"),
    [
        ("darkroom-box-f550-1s", {"IMAGETYP": "Light Frame", "FILTER": "f550"}, "band"),
        ("dark-f550-1s", {"IMAGETYP": "LIGHT", "FILTER": "f550"}, "band"),
        ("reference-box_f650", {"IMAGETYP": "Light", "FILTER": "f650"}, "band"),
        ("f550-1s", {"IMAGETYP": "Dark Frame"}, "dark"),
        ("box-f450", {"IMAGETYP": "Bias"}, "dark"),
        ("f450-1s-x", {"IMAGETYP": "Flat Field", "FILTER": "f450"}, "flat"),
        ("sphere-f450", {"IMAGETYP": "object", "FILTER": "blue"}, "band"),
    ],
)
def test_the_header_comes_before_the_name(tmp_path, name, header, table):
    write_fits(tmp_path / "other.fits", counts(0), EXPTIME=1.0, FILTER="f450", IMAGETYP="Light")
    write_fits(tmp_path / f"{name}.fits", counts(1), EXPTIME=3.0, **header)
    manifest, first = written(tmp_path)
    mine = [t for t in manifest[table] if t["frames"] == [f"{name}.fits"]]
    assert len(mine) == 1 and mine[0]["exposure_s"] == 3.0 and not first.left_out
    if table == "band":
        assert mine[0]["id"] == header["FILTER"]


@pytest.mark.parametrize("exposure", [0.25, 1e-5, 1 / 3, 30.0, 1234.5678])
def test_an_exposure_of_the_header_loses_no_digit(tmp_path, exposure):
    write_fits(tmp_path / "f550-7s.fits", counts(0), EXPTIME=exposure)
    assert written(tmp_path)[0]["band"][0]["exposure_s"] == exposure


# Files that are left out are named


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("f550-1s.sif", "Andor Solis"),
        ("f550-1s.spe", "LightField"),
        ("notes.txt", ".txt"),
        ("IMG_0550.JPG", "raw file"),
        ("README", "README"),
        ("frames/f600-1s.png", "PNG"),
        ("spectra.csv", "use is not certain"),
        ("flat-f700-1s.tif", "no frames of the scene"),
        ("session2/f600-1s.tif", "subfolder"),
    ],
)
def test_every_file_that_was_not_taken_is_named(tmp_path, name, why):
    tiffs(tmp_path, "f450-1s", "f550-1s")
    (tmp_path / name).parent.mkdir(exist_ok=True)
    if name.endswith(".tif"):
        tifffile.imwrite(tmp_path / name, counts(9))
    else:
        (tmp_path / name).write_text("wavelength_nm,a\n400,1\n700,1\n")
    _, first = written(tmp_path)
    assert len(first.left_out) == 1 and why in first.left_out[0].why
    assert first.left_out[0].file in (name, "session2/")


def test_a_link_out_of_the_folder_is_left_out(tmp_path):
    folder = tmp_path / "capture"
    folder.mkdir()
    tiffs(folder, "f450-1s")
    tifffile.imwrite(tmp_path / "outside.tif", counts(5))
    os.symlink(tmp_path / "outside.tif", folder / "f550-1s.tif")
    _, first = written(folder)
    assert [item.file for item in first.left_out] == ["f550-1s.tif"]


# Tables and points of the folder


def spectra(path, *columns):
    path.parent.mkdir(exist_ok=True)
    rows = [",".join(["wavelength_nm", *columns])] + [",".join([str(w)] + ["0.5"] * len(columns)) for w in (400, 700)]
    path.write_text("\n".join(rows))


def test_tables_of_the_folder_are_used(tmp_path):
    tiffs(tmp_path, "f450-1s", "f550-1s", "flat-f450-1s", "sphere-f550-1s")
    spectra(tmp_path / "spectra" / "filters.csv", "f450", "f550", "f650")
    spectra(tmp_path / "spectra" / "camera.csv", "quantum_efficiency", "lens")
    spectra(tmp_path / "spectra" / "lamp.csv", "radiance")
    spectra(tmp_path / "sphere.csv", "radiance")
    points = "\n".join(f"p{k},{k},{k * k},{k % 3},{k},{k}" for k in range(8))
    (tmp_path / "survey.csv").write_text(f"id,x_mm,y_mm,z_mm,u_px,v_px\n{points}\n")
    manifest, first = written(tmp_path)
    assert [table["transmittance"] for table in manifest["band"]] == [
        "spectra/filters.csv:f450",
        "spectra/filters.csv:f550",
    ]
    assert manifest["camera"]["quantum_efficiency"] == "spectra/camera.csv:quantum_efficiency"
    assert manifest["lens"] == {"transmittance": "spectra/camera.csv:lens"}
    assert manifest["lamp"] == {"radiance": "spectra/lamp.csv:radiance"}
    assert manifest["reference"][0]["radiance"] == "sphere.csv:radiance"
    assert manifest["geometry"] == {"points": "survey.csv"}
    assert not first.left_out
    assert [key.example.split(" = ")[0] for key in first.missing if key.required] == ["bit_depth"]
    assert not any(key.example.startswith(("points =", "transmittance =", "radiance =")) for key in first.missing)
    text = (tmp_path / "capture.toml").read_text()
    (tmp_path / "capture.toml").write_text(text.replace("# bit_depth =  ", "bit_depth = 12"))
    load_capture(tmp_path)


@pytest.mark.parametrize(
    ("files", "left_out"),
    [
        ({"lamp.csv": ("radiance",), "spectra/lamp.csv": ("radiance",)}, ["lamp.csv", "spectra/lamp.csv"]),
        ({"filters.csv": ("f450",), "spectra/filters.csv": ("f450",)}, ["filters.csv", "spectra/filters.csv"]),
        ({"other.csv": ("f450",)}, ["other.csv"]),
        ({"lamp.csv": ("power",)}, ["lamp.csv"]),
        ({"sky.csv": ("radiance",)}, ["sky.csv"]),
    ],
)
def test_a_table_whose_use_is_not_certain_is_named(tmp_path, files, left_out):
    tiffs(tmp_path, "f450-1s")
    for name, columns in files.items():
        spectra(tmp_path / name, *columns)
    manifest, first = written(tmp_path)
    assert "lamp" not in manifest and "transmittance" not in manifest["band"][0]
    assert [item.file for item in first.left_out] == left_out


def test_a_faulty_table_is_named_with_its_fault(tmp_path):
    tiffs(tmp_path, "f450-1s")
    (tmp_path / "lamp.csv").write_text("wavelength_nm,radiance\n500,1\n400,x\n")
    manifest, first = written(tmp_path)
    assert ("lamp" not in manifest and "ascending" in first.left_out[0].why) or "'x'" in first.left_out[0].why


# Time, contradictions, mosaics


def test_bands_stand_in_the_order_of_time(tmp_path):
    for k, (band, minute) in enumerate([("f450", 30), ("f550", 10), ("f650", 20), ("f700", 5), ("f400", 59)]):
        moment = f"2026-11-28T10:{minute:02d}:00"
        write_fits(tmp_path / f"{band}.fits", counts(k), EXPTIME=1.0, FILTER=band, **{"DATE-OBS": moment})
    assert list(bands(written(tmp_path)[0])) == ["f700", "f550", "f650", "f450", "f400"]


def test_bands_stand_in_the_order_of_names_where_a_time_is_missing(tmp_path):
    moments = [{"DATE-OBS": "2026-11-28T10:30:00"}, {"DATE-OBS": "2026-11-28T10:10:00"}, {}]
    for k, (band, moment) in enumerate(zip(("f450", "f550", "f1000"), moments, strict=True)):
        write_fits(tmp_path / f"{band}.fits", counts(k), EXPTIME=1.0, FILTER=band, **moment)
    assert list(bands(written(tmp_path)[0])) == ["f450", "f550", "f1000"]


def test_repeats_stand_in_the_order_of_time(tmp_path):
    for k, second in enumerate((30, 10, 20)):
        moment = {"DATE-OBS": f"2026-11-28T10:00:{second}"}
        write_fits(tmp_path / f"f550-{k}.fits", counts(k), EXPTIME=1.0, **moment)
    assert frames(written(tmp_path)[0]) == ["f550-1.fits", "f550-2.fits", "f550-0.fits"]


@pytest.mark.parametrize(
    ("key", "header", "values"),
    [
        ("gain_e_per_dn", "EGAIN", (1.3, 1.4)),
        ("pixel_pitch_um", "XPIXSZ", (9.0, 4.5)),
        ("model", "INSTRUME", ("A", "B")),
    ],
)
def test_contradicting_headers_are_not_outvoted(tmp_path, key, header, values):
    for k, value in enumerate((values[0], values[0], values[1])):
        write_fits(tmp_path / f"f550-1s-{k}.fits", counts(k), **{header: value})
    manifest, first = written(tmp_path)
    assert key not in manifest["camera"]
    assert any(key in missing.why and "the files state" in missing.why for missing in first.missing)


@pytest.mark.parametrize(("down", "right"), [(0, 0), (1, 0), (0, 1), (4, 3), (5, 5)])
def test_a_mosaic_of_six_by_six(tmp_path, down, right):
    rows = shifted(XTRANS, down, right)
    write_dng(tmp_path / "box-1s.dng", np.tile(counts(0), (4, 4)), rows=rows)
    assert written(tmp_path)[0]["mosaic"]["pattern"] == " ".join(rows)
    assert load_capture(tmp_path).manifest.mosaic.pattern == " ".join(rows)


def test_files_of_two_mosaics_are_refused(tmp_path):
    for k, rows in enumerate((("RG", "GB"), ("BG", "GR"))):
        write_dng(tmp_path / f"f550-1s-{k}.dng", np.tile(counts(k), (4, 4)), rows=rows)
    with pytest.raises(InputError, match=r"the mosaic 'BGGR'; expected 'RGGB' as in f550-1s-0\.dng"):
        write_first_manifest(tmp_path)


def test_frames_named_as_the_simulated_ones_need_no_renaming(tmp_path):
    names = [f"{kind}{band}-{k}" for band in ("f450", "open") for kind in ("", "flat-", "sphere-") for k in (0, 1)]
    tiffs(tmp_path, *(f"frames/{name}" for name in [*names, "dark-0.5s-0", "dark-0.5s-1", "dark-4s-0"]))
    manifest, first = written(tmp_path)
    assert not first.left_out
    assert bands(manifest) == {b: [f"frames/{b}-{k}.tif" for k in (0, 1)] for b in ("f450", "open")}
    for kind, word in (("flat", "flat"), ("reference", "sphere")):
        assert {t["band"]: t["frames"] for t in manifest[kind]} == {
            b: [f"frames/{word}-{b}-{k}.tif" for k in (0, 1)] for b in ("f450", "open")
        }
    assert [(t["exposure_s"], len(t["frames"])) for t in manifest["dark"]] == [(0.5, 2), (4.0, 1)]


@pytest.mark.parametrize(
    ("names", "noted"),
    [
        (("IMG_0550", "IMG_0551", "IMG_0552"), "IMG_0550 to IMG_0552"),
        (("light_0001", "light_0002"), "light_0001 to light_0002"),
        (("550", "551"), "550 to 551"),
        (("box-0", "box-1"), None),
        (("f450-1s", "f550-1s"), None),
        (("kitchen", "hall"), None),
    ],
)
def test_numbers_that_may_count_repeats_are_noted(tmp_path, names, noted):
    tiffs(tmp_path, *names)
    _, first = written(tmp_path)
    notes = [key.why for key in first.missing if "differ by a number alone" in key.why]
    assert notes == [] if noted is None else len(notes) == 1 and notes[0].startswith(noted)


@pytest.mark.parametrize("name", ["a\nb.tif", "a\\b.tif", b"f600-\xff.tif".decode("utf-8", "surrogateescape")])
def test_names_that_a_capture_cannot_list(tmp_path, name):
    tiffs(tmp_path, "f550-1s")
    tifffile.imwrite(tmp_path / "x", counts(3))
    os.rename(tmp_path / "x", tmp_path / name)
    manifest, first = written(tmp_path)
    assert frames(manifest) == ["f550-1s.tif"] and "cannot list" in first.left_out[0].why


@pytest.mark.parametrize("target", ["absent.tif", "link.tif"], ids=["nothing", "itself"])
def test_links_that_lead_to_no_file(tmp_path, target):
    tiffs(tmp_path, "f550-1s")
    os.symlink(tmp_path / target, tmp_path / "link.tif")
    _, first = written(tmp_path)
    assert [(item.file, item.why) for item in first.left_out] == [("link.tif", "a link that leads to no file")]


def labelled(folder, shape=SHAPE):
    tiffs(folder, "f450-1s")
    Image.fromarray(np.zeros(shape, np.uint8)).save(folder / "patches.png")
    (folder / "patches.csv").write_text("label,name,column\n1,paper,p1\n2,card,p2\n3,hole,\n")
    spectra(folder / "spectra" / "paints.csv", "p1", "p2", "p3")


def test_labels_of_the_folder_are_used(tmp_path):
    labelled(tmp_path)
    manifest, first = written(tmp_path)
    assert manifest["labels"] == {"image": "patches.png", "names": "patches.csv", "reflectance": "spectra/paints.csv"}
    assert not first.left_out


@pytest.mark.parametrize("spoil", ["size", "second image", "second table", "no table"])
def test_labels_that_are_not_certain_are_named(tmp_path, spoil):
    labelled(tmp_path, (5, 5) if spoil == "size" else SHAPE)
    if spoil == "second image":
        Image.fromarray(np.ones(SHAPE, np.uint8)).save(tmp_path / "b.png")
    if spoil == "second table":
        (tmp_path / "b.csv").write_text((tmp_path / "patches.csv").read_text())
    if spoil == "no table":
        (tmp_path / "patches.csv").unlink()
    manifest, first = written(tmp_path)
    assert "labels" not in manifest and "patches.png" in {item.file for item in first.left_out}


def test_photographs_behind_a_covered_lens_are_no_bands(tmp_path):
    """A camera numbers them as all others; an underexposed photograph and one of a stated filter stay bands."""
    generator = np.random.default_rng(1)
    light = np.outer(np.linspace(0, 1, 64), np.linspace(0.5, 1, 64))
    for number, level in enumerate((2000.0, 2000.0, 0.0, 0.0, 40.0)):
        write_dng(tmp_path / f"IMG_{number:04d}.dng", (100 + generator.poisson(10 + level * light)).astype(np.uint16))
    write_dng(tmp_path / "f550.dng", (100 + generator.poisson(10, (64, 64))).astype(np.uint16))
    manifest, first = written(tmp_path)
    assert [item.file for item in first.left_out if "no light in it" in item.why] == ["IMG_0002.dng", "IMG_0003.dng"]
    assert set(frames(manifest)) == {"IMG_0000.dng", "IMG_0001.dng", "IMG_0004.dng", "f550.dng"}
