"""Frames of every format: counts to the last one, and what the file says; nothing where it says nothing."""

import gzip
import importlib.metadata
import os
import resource
from datetime import datetime

import numpy as np
import OpenEXR
import pytest
import tifffile
from cboxlab.calibration import frame_readers
from cboxlab.calibration.frame_readers import FrameFacts, FrameHeader, frame_header, read_pictures
from cboxlab.calibration.frame_readers._exif import exif_facts_of_raw
from cboxlab.utils.errors import InputError
from helpers.files.frame_files import BAYER, XTRANS, shifted, write_dng, write_fits
from hypothesis import given, settings
from hypothesis import strategies as st

SHAPE = (12, 16)
CUBE = np.random.default_rng(1).integers(0, 65535, (3, *SHAPE)).astype(np.uint16)


def counts(shape, seed=1):
    return np.random.default_rng(seed).integers(0, 4095, shape).astype(np.uint16)


def write_stack(path, stack):
    tifffile.imwrite(path, stack, photometric="minisblack")


def assert_read_exactly(path, image, pictures):
    header = frame_header(path)
    assert header.pictures == pictures and header.shape == image.shape[-2:]
    np.testing.assert_array_equal(read_pictures(path), image.reshape(-1, *image.shape[-2:]))
    last = range(pictures - 1, pictures)
    np.testing.assert_array_equal(read_pictures(path, last), image.reshape(-1, *image.shape[-2:])[-1:])


def test_a_file_that_changes_is_read_again(tmp_path):
    for version in range(3):
        write_stack(tmp_path / "a.tif", counts(SHAPE, version))
        os.utime(tmp_path / "a.tif", ns=(version, version))  # long ago, so that it is kept
        for _ in range(2):
            np.testing.assert_array_equal(picture := read_pictures(tmp_path / "a.tif")[0], counts(SHAPE, version))
            picture[:] = 0  # the pictures kept stay as they are


@pytest.mark.parametrize("name", ["a.fits", "a.FIT", "a.fts", "a.fits.gz", "a.fits.fz", "a.fit.gz"])
@pytest.mark.parametrize("order", ["TOP-DOWN", "BOTTOM-UP"])
@pytest.mark.parametrize("image", [CUBE, CUBE[0]], ids=["cube", "image"])
def test_fits_of_every_packing(tmp_path, name, order, image):
    write_fits(tmp_path / name, image, ROWORDER=order)
    assert_read_exactly(tmp_path / name, image, 3 if image.ndim == 3 else 1)


@pytest.mark.parametrize("options", [{}, {"ome": True}, {"imagej": True}, {"bigtiff": True}, {"metadata": None}])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_tiff_stacks(tmp_path, options, compression):
    axes = {"metadata": {"axes": "TYX"}} if options.keys() & {"ome", "imagej"} else {}
    if compression and "imagej" in options:
        pytest.skip("ImageJ stacks are not packed")
    tifffile.imwrite(tmp_path / "a.tif", CUBE, photometric="minisblack", compression=compression, **options, **axes)
    assert_read_exactly(tmp_path / "a.tif", CUBE, 3)


def test_a_preview_in_a_tiff_is_no_picture(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(CUBE[0], photometric="minisblack", metadata=None)
        file.write(CUBE[0, ::2, ::2], photometric="minisblack", subfiletype=1, metadata=None)
    assert_read_exactly(tmp_path / "a.tif", CUBE[0], 1)


@pytest.mark.parametrize("options", [{"ome": True}, {"imagej": True}])
def test_channels_of_a_stack_are_no_repeats(tmp_path, options):
    tifffile.imwrite(tmp_path / "a.tif", CUBE, photometric="minisblack", metadata={"axes": "CYX"}, **options)
    with pytest.raises(InputError, match=r"a\.tif: found 3 channels in the stack"):
        frame_header(tmp_path / "a.tif")


def test_pages_of_two_sizes_are_no_repeats(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for page in (CUBE[0], CUBE[0, 1:]):
            file.write(page, photometric="minisblack", metadata=None)
    with pytest.raises(InputError, match="repeats of one size"):
        frame_header(tmp_path / "a.tif")


def test_a_stack_described_in_words_loses_no_picture(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", CUBE, photometric="minisblack", truncate=True)
    with pytest.raises(InputError, match="a stack of 3 pictures in one page"):
        frame_header(tmp_path / "a.tif")


@pytest.mark.parametrize("rows", [BAYER, XTRANS], ids=["Bayer", "X-Trans"])
@pytest.mark.parametrize(("down", "right"), [(0, 0), (0, 1), (1, 0), (1, 1), (3, 2), (5, 4)])
def test_the_mosaic_of_a_raw_file(tmp_path, rows, down, right):
    """The expected letters are those of the file, tiled over the frame, one by one."""
    mosaic = shifted(rows, down, right)
    image = counts((48, 66))
    write_dng(tmp_path / "a.dng", image, rows=mosaic, exposure=(1, 3))
    assert_read_exactly(tmp_path / "a.dng", image, 1)
    facts = frame_header(tmp_path / "a.dng").facts
    assert facts.pattern == ("".join(mosaic) if len(mosaic) == 2 else " ".join(mosaic))
    assert (facts.exposure_s, facts.f_number, facts.white_level, facts.model) == (1 / 3, 8, 4095, "Test")
    assert facts.black_level == {"R": 0, "G": 0, "B": 0} and facts.iso is None and facts.time is None


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG", "GRBG", "BGGR"])
@pytest.mark.parametrize(("down", "right"), [(0, 0), (1, 0), (0, 1), (1, 1), (2, 3)])
def test_the_phase_of_a_fits_mosaic(tmp_path, pattern, down, right):
    write_fits(tmp_path / "a.fits", CUBE[0], BAYERPAT=pattern, XBAYROFF=right, YBAYROFF=down, ROWORDER="TOP-DOWN")
    rows = shifted((pattern[:2], pattern[2:]), down, right)
    assert frame_header(tmp_path / "a.fits").facts.pattern == "".join(rows)


def test_a_fits_mosaic_of_six_by_six(tmp_path):
    write_fits(tmp_path / "a.fits", CUBE[0], BAYERPAT="".join(XTRANS), XBAYROFF=2, ROWORDER="TOP-DOWN")
    assert frame_header(tmp_path / "a.fits").facts.pattern == " ".join(shifted(XTRANS, 0, 2))


def test_a_mosaic_of_other_letters_is_refused(tmp_path):
    write_fits(tmp_path / "a.fits", CUBE[0], BAYERPAT="CMYG")
    with pytest.raises(InputError, match="channels C, G, M, Y"):
        frame_header(tmp_path / "a.fits")


def test_what_a_fits_header_says(tmp_path):
    header = {"EXPTIME": 2.5, "FILTER": "f550", "IMAGETYP": "Light Frame", "EGAIN": 1.3, "XPIXSZ": 9.0, "FOCRATIO": 8}
    write_fits(
        tmp_path / "a.fits", CUBE[0], FOCALLEN=35, INSTRUME="PXL", **{"DATE-OBS": "2026-11-28T10:20:30.5"}, **header
    )
    assert frame_header(tmp_path / "a.fits").facts == FrameFacts(
        exposure_s=2.5,
        f_number=8.0,
        focal_length_mm=35.0,
        time=datetime(2026, 11, 28, 10, 20, 30, 500_000),
        kind="light frame",
        filter="f550",
        model="PXL",
        pixel_pitch_um=9.0,
        gain_e_per_dn=1.3,
    )


def test_what_exif_says(tmp_path):
    tags = [(33434, 5, 1, (1, 4), True), (33437, 5, 1, (8, 1), True), (272, "s", 4, "PXL", True)]
    tifffile.imwrite(tmp_path / "a.tif", CUBE[0], extratags=tags)
    assert frame_header(tmp_path / "a.tif").facts == FrameFacts(exposure_s=0.25, f_number=8.0, model="PXL")


@pytest.mark.parametrize(
    "container",
    [
        lambda tiff: tiff,
        lambda tiff: tiff[:2] + b"U\0" + tiff[4:],
        lambda tiff: tiff[:2] + b"RO" + tiff[4:],
        lambda tiff: b"FUJIFILMCCD-RAW 0201FF392201" + bytes(60) + b"\xff\xd8\xff\xe1\0\0Exif\0\0" + tiff,
        lambda tiff: b"\0\0\0\x18ftypcrx " + bytes(40) + b"CMT1" + tiff,
        lambda tiff: b"\0MRM\0\0\0\0" + bytes(30) + b"\0TTW\0\0\1\0" + tiff,
    ],
    ids=["TIFF", "RW2", "ORF", "RAF", "CR3", "MRW"],
)
def test_the_tags_of_a_raw_file_in_every_container(tmp_path, container, caplog):
    """LibRaw does not give the camera's name, by which its sensitivities are found, nor fractions of a second."""
    tags = [(33434, 5, 1, (1, 4), True), (33437, 5, 1, (8, 1), True), (272, "s", 4, "PXL", True)]
    tifffile.imwrite(tmp_path / "a.tif", CUBE[0], extratags=tags, metadata=None)
    (tmp_path / "a.raw").write_bytes(container((tmp_path / "a.tif").read_bytes()))
    facts = exif_facts_of_raw(tmp_path / "a.raw")
    assert facts == FrameFacts(exposure_s=0.25, f_number=8.0, model="PXL")
    assert not caplog.records


def test_a_file_that_says_nothing(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", CUBE[0], metadata=None)
    write_fits(tmp_path / "a.fits", CUBE[0])
    assert frame_header(tmp_path / "a.tif").facts == frame_header(tmp_path / "a.fits").facts == FrameFacts()


def test_an_exr_stack_is_a_band_per_channel(tmp_path):
    stack = {"f450": counts(SHAPE, 3).astype(np.float32), "f550": counts(SHAPE, 4).astype(np.float32) + np.float32(0.4)}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, stack).write(str(tmp_path / "a.exr"))
    assert frame_header(tmp_path / "a.exr") == FrameHeader(SHAPE, 2, FrameFacts(), ("f450", "f550"))
    np.testing.assert_array_equal(read_pictures(tmp_path / "a.exr"), np.stack([counts(SHAPE, 3), counts(SHAPE, 4)]))


def exr_header(data, display):
    windows = {"dataWindow": np.array(data, np.int32), "displayWindow": np.array(display, np.int32)}
    pairs = {name: tuple(window) for name, window in windows.items()}
    return {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **pairs}


def test_the_windows_of_an_exr_picture(tmp_path):
    """A picture may begin anywhere, and have pixels around it that are not shown; none that is shown may be missing."""
    picture = counts(SHAPE, 3).astype(np.float32)
    for name, display in {"shifted": ((5, 7), (20, 18)), "wide": ((6, 9), (18, 17))}.items():
        OpenEXR.File(exr_header(((5, 7), (20, 18)), display), {"Y": picture}).write(str(tmp_path / f"{name}.exr"))
    assert_read_exactly(tmp_path / "shifted.exr", counts(SHAPE, 3), 1)
    assert_read_exactly(tmp_path / "wide.exr", counts(SHAPE, 3)[2:11, 1:14], 1)
    OpenEXR.File(exr_header(((5, 7), (20, 18)), ((4, 7), (20, 18))), {"Y": picture}).write(str(tmp_path / "cut.exr"))
    with pytest.raises(InputError, match=r"cut\.exr: found pixels from \(5, 7\) to .* expected all pixels"):
        frame_header(tmp_path / "cut.exr")


def test_the_parts_of_an_exr_are_bands(tmp_path):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    pictures = {f"f{nm}": counts(SHAPE, nm) for nm in (450, 550)}
    parts = [OpenEXR.Part(dict(header), {"Y": p.astype(np.float32)}, name=name) for name, p in pictures.items()]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    assert frame_header(tmp_path / "a.exr").bands == ("f450", "f550")
    np.testing.assert_array_equal(read_pictures(tmp_path / "a.exr"), np.stack([*pictures.values()]))


def test_values_between_0_and_1_are_no_counts(tmp_path):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Y": np.full(SHAPE, 0.5, np.float32)}).write(str(tmp_path / "a.exr"))
    with pytest.raises(InputError, match="Multiply by the largest count"):
        read_pictures(tmp_path / "a.exr")


@pytest.mark.parametrize("value", [-1.0, 70000.0, np.nan])
def test_fits_values_that_are_no_counts(tmp_path, value):
    write_fits(tmp_path / "a.fits", np.full(SHAPE, value, np.float32))
    with pytest.raises(InputError, match=r"a\.fits: found values"):
        read_pictures(tmp_path / "a.fits")


@pytest.mark.parametrize("name", ["a.fits", "a.fits.gz", "a.fits.fz", "a.dng", "a.cr2", "a.exr", "a.tif", "a.xyz"])
def test_damaged_files_are_named(tmp_path, name):
    (tmp_path / name).write_bytes(b"no frame at all")
    with pytest.raises(InputError, match=name):
        frame_header(tmp_path / name)


@pytest.mark.parametrize("kind", ["RICE_1", "GZIP_2", "PLIO_1", "HCOMPRESS_1"])
def test_a_compressed_image_may_have_the_ending_of_a_plain_one(tmp_path, kind):
    """As CFITSIO's programs write them: cube.fits with the image in a table."""
    fits = pytest.importorskip("astropy.io.fits", reason="needs astropy (extra 'readers')")
    image = counts((3, 48, 64)) // 4
    tiles = (1, 48, 64) if kind == "HCOMPRESS_1" else None
    unit = fits.CompImageHDU(image[:, ::-1].astype(np.int32), compression_type=kind, tile_shape=tiles)
    fits.HDUList([fits.PrimaryHDU(), unit]).writeto(tmp_path / "a.fits")
    assert_read_exactly(tmp_path / "a.fits", image, 3)
    (tmp_path / "b.fits").write_bytes((tmp_path / "a.fits").read_bytes()[:-4000])
    with pytest.raises(InputError, match="truncated"):
        read_pictures(tmp_path / "b.fits")


@pytest.mark.parametrize("name", ["a.fits", "a.fits.gz", "a.fits.fz", "a.tif"])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_truncated_files_are_named(tmp_path, name, share):
    image = counts((3, 150, 100))
    write_fits(tmp_path / name, image) if "fits" in name else write_stack(tmp_path / name, image)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=name):
        read_pictures(tmp_path / name)


@pytest.mark.parametrize(("share", "empty_rows", "is_truncated"), [(1.0, 1, True), (0.05, 30, True), (0.01, 3, False)])
def test_a_raw_picture_that_ends_in_zeros_is_truncated(tmp_path, share, empty_rows, is_truncated):
    """LibRaw reads a packed file without its end so; dark frames have few counts, and empty rows by chance."""
    generator = np.random.default_rng(5)
    image = ((generator.random((60, 80)) < share) * generator.integers(1, 900, (60, 80))).astype(np.uint16)
    image[-empty_rows:] = 0
    write_dng(tmp_path / "a.dng", image)
    if is_truncated:
        with pytest.raises(InputError, match=f"below row {59 - empty_rows} of 60"):
            read_pictures(tmp_path / "a.dng")
    else:
        assert np.array_equal(read_pictures(tmp_path / "a.dng")[0], image)


def test_a_packed_file_that_announces_more_than_it_holds(tmp_path):
    cards = ["SIMPLE  =                    T", "BITPIX  =                   16", "NAXIS   =                    2"]
    cards += [f"NAXIS{k}  =               100000" for k in (1, 2)] + ["END"]
    (tmp_path / "a.fits.gz").write_bytes(gzip.compress("".join(f"{card:80}" for card in cards).ljust(2880).encode()))
    with pytest.raises(InputError, match=r"according to its header|bytes of compressed data"):
        frame_header(tmp_path / "a.fits.gz")


@pytest.mark.parametrize("start", ["SIMPLE  =                    T", "XTENSION= 'IMAGE   '", "NOTHING"])
@pytest.mark.parametrize("whole_before", [False, True])
def test_a_packed_header_without_end_is_refused(tmp_path, start, whole_before):
    write_fits(tmp_path / "a.fits", CUBE[0])
    before = (tmp_path / "a.fits").read_bytes() if whole_before else b""
    (tmp_path / "b.fits.gz").write_bytes(gzip.compress(before + start.ljust(2**27).encode(), 9))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=r"b\.fits\.gz: found (a header without end|bytes that are no header)"):
        frame_header(tmp_path / "b.fits.gz")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < 50 * 1024


FITS_NAMES = ["f.fits", "f.fits.gz", "f.fits.fz"]


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(FITS_NAMES), st.integers(0, 20_000), st.integers(0, 255))
def test_a_fits_frame_with_another_byte_is_read_or_refused(tmp_path_factory, name, byte_index, byte):
    path = tmp_path_factory.mktemp("frame") / name
    write_fits(path, CUBE, EXPTIME=1.0, BAYERPAT="RGGB")
    content = bytearray(path.read_bytes())
    content[byte_index % len(content)] = byte
    path.write_bytes(content)
    try:
        assert read_pictures(path).dtype == np.uint16
    except InputError as fault:
        assert path.name in str(fault)


@pytest.mark.parametrize(("name", "package"), [("a.fits", "astropy"), ("a.dng", "rawpy")])
def test_a_missing_package_is_named_once(tmp_path, monkeypatch, name, package):
    (tmp_path / name).write_bytes(b"whatever")
    monkeypatch.setattr(frame_readers, "find_spec", lambda module: None)
    with pytest.raises(InputError, match=rf"needs the package {package} .*pip install 'cboxlab\[readers\]'"):
        frame_header(tmp_path / name)


def test_the_readers_are_the_files_of_the_folder():
    assert list(frame_readers.frame_reader_catalogue()) == ["exr", "fits", "hdr", "png", "raw", "tiff"]
    assert importlib.metadata.entry_points(group="cboxlab.frames") is not None
