"""Inputs of excessive size: refused by their headers, in little time and memory."""

import resource
import struct
import subprocess
import sys
import time
import zlib

import numpy as np
import pytest
from cboxlab.calibration.frame_readers import frame_header
from cboxlab.rendering.files import read_cube
from cboxlab.rendering.files.exr_channels import read_channels as read_exr
from cboxlab.rendering.model import load_model
from cboxlab.scenes import load_scene, read_spectrum
from cboxlab.scenes.shapes import file_mesh
from cboxlab.utils import limits
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import read_channels

#: Largest time and memory of a refusal; on a busy machine the time counts this process alone.
MAX_CPU_S, MAX_BYTES = 5.0, 512 * 2**20


def png(path, width, height):
    """A PNG whose header states a size, with data of one row."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = zlib.compress(bytes(3 * width + 1))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b""))


def fits(path, side):
    """A FITS file whose header states a size, with one block of data."""
    entries = ["SIMPLE  = T", "BITPIX  = 16", "NAXIS   = 2", f"NAXIS1  = {side}", f"NAXIS2  = {side}", "END"]
    content = "".join(entry.ljust(80) for entry in entries).ljust(2880).encode() + bytes(2880)
    if path.suffix == ".gz":
        import gzip

        content = gzip.compress(content)
    path.write_bytes(content)


def envi(path, side):
    """A sparse ENVI cube of 31 bands."""
    text = f"ENVI\nsamples = {side}\nlines = {side}\nbands = 31\ndata type = 4\ninterleave = bsq\nbyte order = 0\n"
    bands = ", ".join(str(400 + 10 * k) for k in range(31))
    path.write_text(text + f"data units = W m^-2 sr^-1 nm^-1\nwavelength units = nm\nwavelength = {{{bands}}}\n")
    with path.with_suffix(".img").open("wb") as file:
        file.truncate(31 * 4 * side**2)


def padded(path):
    """A packed FITS file with a hole of a gigabyte after it, whose zeros the library would read one by one."""
    fits(path, 10)
    with path.open("ab") as file:
        file.truncate(2**30)


def text(content):
    return lambda path: path.write_text(content)


BOX = 'format = "model/1"\n'
CASES = {
    "texture.png": (lambda path: png(path, 10_000, 10_000), read_channels, "pixels; expected at most"),
    "frame.fits": (lambda path: fits(path, 30_000), frame_header, "at most|truncated"),
    "frame.fits.gz": (lambda path: fits(path, 40_000), frame_header, "bytes of compressed data"),
    "padded.fits.gz": (padded, frame_header, "zeros at the end"),
    "cube.hdr": (lambda path: envi(path, 5000), read_cube, "values"),
    "picture.hdr": (
        text("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 30000 +X 30000\n"),
        read_cube,
        "values",
    ),
    "dotted.toml": (text(BOX + ".".join(["a"] * 16_000) + " = 1\n"), load_model, "nested too deeply"),
    "table.toml": (text(BOX + "[" + ".".join(["a"] * 16_000) + "]\n"), load_model, "nested too deeply"),
    "blanks.toml": (text(" " * 1_000_000), load_model, "this key is required"),
    "lines.toml": (text("\n" * 1_000_000), load_model, "this key is required"),
    "keys.toml": (text(BOX + "".join(f"k{i} = 1\n" for i in range(80_000))), load_model, "unknown key"),
    "scene.toml": (
        text('format = "scene/1"\n' + "".join(f"k{i} = 1\n" for i in range(80_000))),
        load_scene,
        "unknown key",
    ),
    "rows.csv": (text("wavelength_nm,a\n" + "1,1\n" * 2_000_000), lambda p: read_spectrum(p, "a"), "rows"),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_too_large_is_refused_soon_and_in_little_memory(tmp_path, name):
    write, read, fault = CASES[name]
    path = tmp_path / name
    write(path)
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    with pytest.raises(InputError, match=fault) as error:
        read(path)
    assert time.process_time() - start < MAX_CPU_S
    assert 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) < MAX_BYTES
    assert "\n" not in str(error.value)


def test_an_openexr_picture_over_the_limit_is_refused_by_its_header(tmp_path, monkeypatch):
    import OpenEXR
    from cboxlab.rendering.files import exr_channels
    from cboxlab.validation.compare.maps import read_map

    planes = {"X": np.ones((8, 8), np.float32), "Y": np.ones((8, 8), np.float32)}
    OpenEXR.File({}, planes).write(str(tmp_path / "a.exr"))
    monkeypatch.setattr(exr_channels, "MAX_CUBE_VALUES", 127)
    for read in (read_exr, read_map):
        with pytest.raises(InputError, match="found 128 values; expected at most 127"):
            read(tmp_path / "a.exr")
    monkeypatch.setattr(exr_channels, "MAX_CUBE_VALUES", 128)
    assert set(read_exr(tmp_path / "a.exr").planes) == {"X", "Y"}


def test_a_material_for_every_triangle_takes_no_more_time(tmp_path):
    """Time grew with the square of the number of materials."""
    lines = "v 0 0 0\nv 1 0 0\nv 0 1 0\nmtllib a.mtl\n" + "".join(f"usemtl m{i}\nf 1 2 3\n" for i in range(20_000))
    (tmp_path / "m.obj").write_text(lines)
    start = time.process_time()
    vertices, faces = file_mesh(tmp_path / "m.obj", 1.0)
    assert faces.shape == (20_000, 3) and time.process_time() - start < MAX_CPU_S
    np.testing.assert_allclose(np.asarray(vertices)[faces[7]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_the_limits_admit_what_is_in_use():
    assert limits.MAX_FRAME_PIXELS > 151e6  # 14204 x 10652 px, the largest sensor on sale
    assert limits.MAX_CUBE_VALUES >= 512 * 512 * 1024
    limits.require_size("x", limits.MAX_TABLE_ROWS, limits.MAX_TABLE_ROWS, "rows")


@pytest.mark.parametrize(("command", "gib"), [("validate", 1), ("studio", 3)])
def test_a_limit_of_address_space_ends_in_a_sentence(command, gib):
    program = (
        "import resource, sys; from cboxlab.validation.app.commands.app import run as main; size = int(sys.argv[2]); "
    )
    program += "resource.setrlimit(resource.RLIMIT_AS, (size, size)); sys.argv = ['cbox', sys.argv[1], 'x']; main()"
    arguments = [sys.executable, "-c", program, command, str(gib * 2**30)]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2 and f"{gib} GiB of address space" in done.stderr + done.stdout
