"""A first manifest lists each photograph once, however often it runs, and writes over none."""

import gzip
import hashlib
import shutil
import tomllib

import numpy as np
import OpenEXR
import pytest
import tifffile
from cboxlab.calibration.capture.first_manifest import write_first_manifest
from cboxlab.utils.errors import InputError
from helpers.files.frame_files import write_dng, write_fits

SHAPE = (12, 16)


def counts(seed):
    return np.random.default_rng(seed).integers(0, 4095, SHAPE).astype(np.uint16)


def tiffs(folder, *names):
    for seed, name in enumerate(names):
        (folder / name).parent.mkdir(exist_ok=True)
        tifffile.imwrite(folder / f"{name}.tif", counts(seed))


def exr(path, **seeds):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name: counts(seed).astype(np.float32) for name, seed in seeds.items()}).write(str(path))


def written(folder):
    first = write_first_manifest(folder)
    with (folder / "capture.toml").open("rb") as file:
        return tomllib.load(file), first


def frames(manifest):
    """Frames of all tables; those that several channels of a mosaic share, once."""
    tables = [
        table for key in ("band", "bracket", "dark", "flat", "reference", "target") for table in manifest.get(key, [])
    ]
    letters = [table["channel"] for table in tables if "channel" in table]
    return [frame for table in tables if table.get("channel") in (None, *letters[:1]) for frame in table["frames"]]


def digests(folder):
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def bands(manifest):
    return {table["id"]: table["frames"] for table in manifest["band"]}


# Nothing is written over, and no photograph is listed twice


def fits_and_tiff(folder):
    write_fits(folder / "f550-0.fits", counts(0), EXPTIME=1.0)
    write_fits(folder / "f550-1.fits", counts(1), EXPTIME=1.0)


def raw_files(folder):
    for seed in (0, 1):
        write_dng(folder / f"IMG_{550 + seed:04d}.dng", np.tile(counts(seed), (4, 4)))


def exr_stack(folder):
    exr(folder / "box.exr", f450=0, f550=1)


def packed_files(folder):
    write_fits(folder / "f550-0.fits.gz", counts(0), EXPTIME=1.0)
    write_fits(folder / "f550-1.fits.fz", counts(1), EXPTIME=1.0)


def cube(folder):
    write_fits(folder / "f550.fits", np.stack([counts(0), counts(1)]), EXPTIME=1.0)


def equal_counts(folder):
    """Two dark frames of nothing but zeros are two photographs."""
    fits_and_tiff(folder)
    for index in (0, 1):
        tifffile.imwrite(folder / f"dark-1s-{index}.tif", np.zeros(SHAPE, np.uint16))


def copies(folder):
    """Copies of file managers; a frame of the same counts with a different name is a photograph."""
    tiffs(folder, "f550-1s-0", "f550-1s-1")
    for copy in ("f550-1s-0 - Copy", "f550-1s-0 - Kopie (2)", "f550-1s-0 copy 2", "f550-1s-0 (2)", "f600-1s-0"):
        shutil.copy(folder / "f550-1s-0.tif", folder / f"{copy}.tif")
    write_fits(folder / "f650-1s-0.fits", counts(5))
    shutil.copy(folder / "f650-1s-0.fits", folder / "Copy of f650-1s-0.fits")


@pytest.mark.parametrize("make", [fits_and_tiff, raw_files, exr_stack, packed_files, cube, equal_counts, copies])
def test_each_photograph_once_however_often_it_runs(tmp_path, make):
    make(tmp_path)
    before = digests(tmp_path)
    first, _ = written(tmp_path)
    for _ in range(2):
        after = digests(tmp_path)
        assert before.items() <= after.items()
        text = (tmp_path / "capture.toml").read_text()
        (tmp_path / "capture.toml").unlink()
        again, _ = written(tmp_path)
        assert again == first and (tmp_path / "capture.toml").read_text() == text
    listed = frames(first)
    assert len(listed) == len(set(listed))
    pictures = {"cube": 1, "equal_counts": 4, "copies": 4}.get(make.__name__, 2)
    assert len(listed) == pictures


@pytest.mark.parametrize("name", ["f550-0", "f550-0.5s-0", "anything"])
def test_tiffs_of_an_earlier_run_are_no_further_photographs(tmp_path, name):
    """Earlier versions wrote each FITS frame once more; since then the originals may have been renamed."""
    tiffs(tmp_path, "frames/f550-0", "frames/f550-1")
    write_fits(tmp_path / f"{name}.fits", counts(0), FILTER="f550", EXPTIME=0.5)
    write_fits(tmp_path / "f550-1.fits", counts(1), FILTER="f550", EXPTIME=0.5)
    manifest, first = written(tmp_path)
    assert sorted(frames(manifest)) == sorted([f"{name}.fits", "f550-1.fits"])
    assert {item.file for item in first.left_out} == {"frames/f550-0.tif", "frames/f550-1.tif"}
    assert all("the same counts as" in item.why for item in first.left_out)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("f550-1s.fits", "frames/f550-1s.tif"),
        ("f550-1s.tif", "frames/f550-1s.tif"),
        ("f550-1s.fits", "f550-1s.fits.gz"),
        ("f550-1s.tiff", "f550-1s.tif"),
        ("F550-1s.fits", "f550-1s.tif"),
        ("f550-1s.dng", "f550-1s.tif"),
    ],
)
def test_two_photographs_of_one_name_are_refused(tmp_path, first, second):
    (tmp_path / "frames").mkdir()
    for seed, name in enumerate((first, second)):
        image = np.tile(counts(seed), (4, 4))
        if name.endswith(".dng"):
            write_dng(tmp_path / name, image)
        elif "fits" in name:
            write_fits(tmp_path / name, image)
        else:
            tifffile.imwrite(tmp_path / name, image)
    before = digests(tmp_path)
    with pytest.raises(InputError) as refusal:
        write_first_manifest(tmp_path)
    assert first.rpartition("/")[2] in str(refusal.value) and second.rpartition("/")[2] in str(refusal.value)
    assert digests(tmp_path) == before


def test_the_same_counts_packed_and_not(tmp_path):
    write_fits(tmp_path / "f550-1s.fits", counts(0))
    (tmp_path / "f550-1s.fits.gz").write_bytes(gzip.compress((tmp_path / "f550-1s.fits").read_bytes()))
    manifest, first = written(tmp_path)
    assert len(frames(manifest)) == len(first.left_out) == 1


def test_a_band_of_a_stack_is_written_over_no_frame(tmp_path):
    exr_stack(tmp_path)
    tiffs(tmp_path, "x", "frames/box-f450")
    before = digests(tmp_path)
    with pytest.raises(InputError, match="box-f450"):
        write_first_manifest(tmp_path)
    assert digests(tmp_path) == before
