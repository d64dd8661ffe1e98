"""Damaged and hostile files end in one message that names them, quickly and without much memory."""

import json
import os
import resource
import shutil
import struct
import zlib

import h5py
import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture.frames import read_frame
from cboxlab.calibration.capture.labels import read_labels
from cboxlab.calibration.capture.manifest_faults import read_manifest
from cboxlab.calibration.geometry.surveyed_points import read_points
from cboxlab.rendering.files import read_cube, write_cube
from cboxlab.rendering.files.cube_checks import as_cube
from cboxlab.rendering.model.model_file import load_model
from cboxlab.rendering.sensor.cameras import load_camera
from cboxlab.scenes.scene_file import load_scene
from cboxlab.scenes.shapes import file_mesh
from cboxlab.scenes.spectra import read_spectra
from cboxlab.utils.errors import InputError
from cboxlab.validation.api import verify
from cboxlab.validation.app.commands.cli import main
from cboxlab.validation.compare_renders.stored_references.stored import read_reference
from cboxlab.validation.dataset import open_dataset
from cboxlab.validation.synthetic.blind import open_seal, read_diagnosis
from helpers.places import ROOT
from hypothesis import given
from hypothesis import strategies as st

TOML = {"scene": load_scene, "model": load_model, "camera": load_camera, "manifest": read_manifest}
TEXT = {
    **TOML,
    "spectra": read_spectra,
    "points": read_points,
    "labels": read_labels,
    "diagnosis": read_diagnosis,
}
CUBE = as_cube(np.arange(24.0, dtype=np.float32).reshape(3, 4, 2) + 1, [500.0, 600.0])


def assert_refused(read, path, *phrases):
    with pytest.raises(InputError) as refusal:
        read(path)
    assert str(path.name) in str(refusal.value)
    for word in phrases:
        assert word in str(refusal.value)


@pytest.mark.parametrize("kind", TOML)
@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 20_000 + "]" * 20_000,
        ".".join("a" * 5000) + " = 1",
        "format = " + "9" * 5000,
        "format = " + "9" * 4000,
        "width = 1e99999999",
        "a = '\0'",
        "[a]\n" * 300_000,
        "\ufeff" * 3,
    ],
    ids=["deep", "dotted", "digits", "large", "exponent", "nul", "long", "marks"],
)
def test_toml_of_any_kind_is_refused_in_one_message(tmp_path, kind, text):
    path = tmp_path / "file.toml"
    path.write_text(text, encoding="utf-8")
    assert_refused(TOML[kind], path)


@pytest.mark.parametrize("kind", TEXT)
def test_only_regular_files_are_read(tmp_path, kind):
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)
    assert_refused(TEXT[kind], pipe, "not a file")
    loop = tmp_path / "loop.toml"
    loop.symlink_to(loop)
    assert_refused(TEXT[kind], loop)
    assert_refused(TEXT[kind], tmp_path / "absent.toml", "no such file")


@given(content=st.binary(max_size=300), kind=st.sampled_from(sorted(TEXT)))
def test_bytes_at_random_are_refused(tmp_path_factory, content, kind):
    path = tmp_path_factory.mktemp("random") / "file.toml"
    path.write_bytes(content)
    assert_refused(TEXT[kind], path)


def frame(path, **changes):
    tifffile.imwrite(path, np.arange(64, dtype=np.uint16).reshape(8, 8), **changes)
    return path


def test_a_frame_that_unpacks_without_end_is_refused(tmp_path):
    path = frame(tmp_path / "bomb.tif", compression="zlib", rowsperstrip=8)
    bomb = zlib.compress(bytes(2**28), 9)
    content = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        tags = file.pages.first.tags
        offsets = tags["StripOffsets"].valueoffset, tags["StripByteCounts"].valueoffset
        kinds = tags["StripOffsets"].dtype, tags["StripByteCounts"].dtype
    for offset, kind, value in zip(offsets, kinds, (len(content), len(bomb)), strict=True):
        if kind == tifffile.DATATYPE.SHORT:
            pytest.skip("the writer stored 16-bit offsets")
        content[offset : offset + 4] = struct.pack("<I", value)
    path.write_bytes(bytes(content) + bomb)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert_refused(lambda p: read_frame(p, 8, 8, 16), path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100 * 1024


@pytest.mark.parametrize("size", range(12))
def test_the_beginning_of_a_frame_is_refused(tmp_path, size):
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((3, 4), np.uint16))
    (tmp_path / "a.tif").write_bytes((tmp_path / "a.tif").read_bytes()[:size])
    assert_refused(lambda path: read_frame(path, 3, 4, 12), tmp_path / "a.tif")


def test_a_unit_that_is_no_text_is_refused(tmp_path):
    write_cube(tmp_path / "cube.nc", CUBE)
    with h5py.File(tmp_path / "cube.nc", "r+") as file:
        file["radiance"].attrs["units"] = 3.0
    assert_refused(read_cube, tmp_path / "cube.nc", "the unit '3.0'")


def test_a_diagnosis_with_a_number_for_parameters_is_refused(tmp_path):
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps({"ranking": [{"effect": "haze", "parameters": 1.0}], "selected": ["haze"]}))
    assert_refused(read_diagnosis, path, "a diagnosis")


def test_an_effect_whose_name_is_a_list_is_refused(tmp_path):
    path = tmp_path / "model.toml"
    path.write_text('format = "model/1"\nname = "a"\nscene = "cornell-box"\n[[effect]]\nid = []\n')
    assert_refused(load_model, path, "effect[0].id", "[]")


@pytest.mark.parametrize(
    ("change", "phrase"),
    [({"seed": float("inf")}, "no reference"), ({"means": {"floor": 10**400}}, "an integer of 401 digits")],
)
def test_a_reference_with_numbers_without_end_is_refused(tmp_path, change, phrase):
    record = {
        "format": "light-reference/1",
        "means": {"floor": 1.0},
        "sigma": {"floor": 1e-4},
        "degrees": 7.0,
    }
    path = tmp_path / "reference.json"
    path.write_text(json.dumps({**record, "seed": 1, "samples": 4, "versions": {}, **change}))
    assert_refused(read_reference, path, phrase)


def test_a_turned_frame_is_refused(tmp_path):
    path = frame(tmp_path / "turned.tif", extratags=[(274, "H", 1, 6, True)])
    assert_refused(lambda p: read_frame(p, 8, 8, 16), path, "orientation 6")


@given(st.integers(0, 10_000), st.integers(0, 255))
def test_a_frame_with_another_byte_is_read_or_refused(tmp_path_factory, byte_index, byte):
    path = frame(tmp_path_factory.mktemp("frame") / "f.tif", compression="zlib", predictor=True)
    content = bytearray(path.read_bytes())
    content[byte_index % len(content)] = byte
    path.write_bytes(content)
    try:
        assert read_frame(path, 8, 8, 16).shape == (8, 8)
    except InputError as fault:
        assert path.name in str(fault)


@given(st.sampled_from([".nc", ".exr", ".hdr"]), st.integers(0, 100_000), st.integers(0, 255))
def test_a_cube_with_another_byte_is_read_or_refused(tmp_path_factory, ending, byte_index, byte):
    path = tmp_path_factory.mktemp("cube") / f"cube{ending}"
    write_cube(path, CUBE)
    content = bytearray(path.read_bytes())
    content[byte_index % len(content)] = byte
    path.write_bytes(content)
    try:
        read_cube(path)
    except InputError as fault:
        assert "cube" in str(fault)


def test_radiance_in_another_file_is_refused(tmp_path):
    path, secret = tmp_path / "outside.nc", tmp_path / "secret"
    secret.write_bytes(bytes(96))
    write_cube(path, CUBE)
    with h5py.File(path, "r+") as file:
        del file["radiance"]
        file.create_dataset("radiance", (3, 4, 2), "f4", external=[(str(secret), 0, 96)])
    assert_refused(read_cube, path, "another file")
    with h5py.File(path, "r+") as file:
        del file["radiance"]
        file["radiance"] = h5py.ExternalLink(str(tmp_path / "other.nc"), "/radiance")
    assert_refused(read_cube, path, "a link")


def test_an_array_without_values_is_refused(tmp_path):
    path = tmp_path / "sparse.nc"
    with h5py.File(path, "w") as file:
        file.create_dataset("radiance", (60_000, 60_000, 31), "f4", chunks=(64, 64, 31))
    assert_refused(read_cube, path, "bytes for an array")


@pytest.mark.parametrize(
    ("line", "phrase"),
    [
        ("data gain values = {2, 2, 2}", "data gain values"),
        ("data gain values = {2, -2}", "data gain values"),
        ("byte order = 7", "byte order"),
        ("lines = -3", "negative"),
        ("wavelength = {500, 1e99999999}", "wavelength"),
        ("bands = " + "9" * 5000, "bands"),
        ("wavelength = {500, 600" + " " * 60_000, "wavelength"),
        ("description" + " " * 60_000, None),
    ],
)
def test_envi_headers(tmp_path, line, phrase):
    path = tmp_path / "cube.hdr"
    write_cube(path, CUBE)
    key = line.split(" = ")[0]
    others = [each for each in path.read_text().splitlines() if not each.startswith(f"{key} = ")]
    path.write_text("\n".join([*others, line]) + "\n")
    if phrase is None:
        assert read_cube(path)["radiance"].shape == (3, 4, 2)
    else:
        assert_refused(read_cube, path, phrase)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_radiance_that_is_not_finite_is_located(tmp_path, value):
    path = tmp_path / "cube.exr"
    write_cube(path, as_cube(np.where(CUBE.radiance.values == 7, value, CUBE.radiance.values), [500.0, 600.0]))
    assert_refused(read_cube, path, "1 values that are not finite", "'y': 0", "'x': 3")


@pytest.mark.parametrize("ending", [".nc", ".exr", ".hdr"])
def test_a_measured_cube_may_lack_pixels(tmp_path, ending):
    radiance = np.where(CUBE.radiance.values == 7, np.nan, CUBE.radiance.values)
    path = tmp_path / f"cube{ending}"
    write_cube(path, as_cube(radiance, [500.0, 600.0], missing=True))
    assert np.array_equal(read_cube(path)["radiance"].values, radiance, equal_nan=True)


def test_complex_radiance_is_refused(tmp_path):
    path = tmp_path / "cube.nc"
    write_cube(path, CUBE)
    with h5py.File(path, "r+") as file:
        attributes, scales = dict(file["radiance"].attrs), file["wavelength"]
        del attributes["DIMENSION_LIST"]
        del file["radiance"]
        file.create_dataset("radiance", data=np.ones((3, 4, 2), complex))
        assert scales.shape == (2,)
    assert_refused(read_cube, path, "radiance")


@pytest.mark.parametrize("content", [[], {}, {"sha256_of_salt_and_answer": 3}, {"sha256_of_salt_and_answer": "0"}])
def test_seals_of_another_form_are_refused(tmp_path, content):
    (tmp_path / "sealed.json").write_text(json.dumps(content))
    (tmp_path / "answer.sealed").write_text("AAAA")
    with pytest.raises(InputError):
        open_seal(tmp_path)


def test_a_fault_of_the_program_is_one_line_and_a_trace_file(tmp_path, monkeypatch, capsys):
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("planted")

    monkeypatch.setattr("cboxlab.validation.app.commands.app.app", fail)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(SystemExit) as ended:
        main(["effects"])
    said = capsys.readouterr().err.strip()
    (trace,) = tmp_path.glob("cboxlab-trace-*")
    assert ended.value.code == 3
    assert "Traceback" not in said
    assert trace.name in said.replace("\n", "")
    assert "planted" in trace.read_text()


def test_names_are_printed_as_they_are(tmp_path, capsys):
    from cboxlab.validation.app.commands.console import console, data_table, say

    table = data_table("t", "a", "b")
    table.add_row("[bold]wall[/]", ":smile: [/]")
    with console.capture() as printed:
        console.print(table)
        say("[red]x[/red]")
    for text in ("[bold]wall[/]", ":smile: [/]", "[red]x[/red]"):
        assert text in printed.get()


PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
"""
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
STL = (
    "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n"
)


@pytest.mark.parametrize(("ending", "text"), [("ply", PLY), ("obj", OBJ), ("stl", STL)])
@pytest.mark.parametrize(
    ("new", "phrase"), [("nan 0 0", "vertex 2 at (nan, 0.0, 0.0)"), ("1e999 0 0", "finite"), ("1_0 0 0", "mesh")]
)
def test_a_mesh_with_a_coordinate_that_is_no_number_is_refused(tmp_path, ending, text, new, phrase):
    path = tmp_path / f"mesh.{ending}"
    path.write_text(text)
    assert file_mesh(path, 1.0)[0].shape == (3, 3)
    path.write_text(text.replace("1 0 0", new))
    assert_refused(lambda p: file_mesh(p, 1.0), path, phrase)


@pytest.mark.parametrize("end", ["", "end_head"])
def test_a_ply_file_whose_header_does_not_end_is_refused(tmp_path, end):
    path = tmp_path / "mesh.ply"
    path.write_text(PLY.partition("end_header")[0] + end)
    assert_refused(lambda p: file_mesh(p, 1.0), path, "a header without its end", "export it again")


@pytest.mark.parametrize(("meaning", "phrase"), [("miniswhite", "WhiteIsZero"), ("palette", "palette")])
def test_a_frame_whose_values_fall_with_light_is_refused(tmp_path, meaning, phrase):
    colours = {"colormap": np.zeros((3, 2**16), np.uint16)} if meaning == "palette" else {}
    path = frame(tmp_path / "frame.tif", photometric=meaning, **colours)
    assert_refused(lambda p: read_frame(p, 8, 8, 16), path, phrase, "BlackIsZero")


def test_numbers_of_a_table_are_those_of_a_table(tmp_path):
    """Python reads 4_00 as 400: a slip of the keyboard would be a measured value."""
    spectra = tmp_path / "spectra.csv"
    spectra.write_text("wavelength_nm,a\n4_00,1\n500,1\n")
    assert_refused(read_spectra, spectra, "line 2, wavelength_nm", "'4_00'", "a finite number")
    points = tmp_path / "points.csv"
    points.write_text("id,x_mm,y_mm,z_mm,u_px,v_px\na,0,0,0,1_0,1\n")
    assert_refused(read_points, points, "line 2, u_px", "'1_0'")


def test_a_result_that_cannot_be_looked_at_is_named(tmp_path, capsys):
    """A name that no file system takes, in a manifest that somebody sent."""
    entry = {"bytes": 1, "sha256": "0"}
    content = {"format": "result-manifest/1", "inputs": {}, "outputs": {"a" * 300: entry}}
    (tmp_path / "manifest.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="File name too long"):
        verify(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["verify", str(tmp_path / ("b" * 300))])
    assert ended.value.code == 2 and capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("old", "new"),
    [(b"29343", b"29_343"), (b"29343", b"many"), (b"146.729", b""), (b"main,train", b"\xff,train"), (b"0,0,0", b"0")],
)
def test_an_index_of_a_data_set_with_a_row_that_is_none_is_refused(tmp_path, old, new):
    shutil.copytree(ROOT / "tests" / "version_0_1" / "dataset", tmp_path / "dataset")
    path = tmp_path / "dataset" / "index.csv"
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    assert_refused(lambda p: open_dataset(p.parent), path)
