"""The command line: a mistake ends in one line of help, exit code 2 and nothing written; what is right works.

Broken captures are copies of the bundled one with a single fault.
"""

import json
import re
import shutil
import subprocess
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.rendering.model import named_effect
from cboxlab.rendering.model.model_file import load_model
from cboxlab.scenes import cornell_camera
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import folder_lock
from cboxlab.validation.app.commands import console
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE
from cboxlab.validation.synthetic.blind import open_seal
from helpers.files.camera_files import write_camera
from helpers.programs.command_line import assert_one_line_of_help


@pytest.fixture
def capture(tmp_path):
    """A copy of the bundled capture, to be broken."""
    return shutil.copytree(DEMO_CAPTURE, tmp_path / "capture")


def edit(folder, pattern, new):
    path = folder / "capture.toml"
    text, count = re.subn(pattern, new, path.read_text(), count=1)
    assert count == 1
    path.write_text(text)


def truncated_tiff(folder):
    path = folder / "frames" / "f550-1.tif"
    path.write_bytes(path.read_bytes()[:-2000])


def missing_file(folder):
    (folder / "frames" / "f550-1.tif").unlink()


def wrong_size(folder):
    path = folder / "frames" / "f550-1.tif"
    tifffile.imwrite(path, tifffile.imread(path)[:100])


def wrong_kind(folder):
    path = folder / "frames" / "f550-1.tif"
    tifffile.imwrite(path, (tifffile.imread(path) // 16).astype(np.uint8))


def wrong_bit_depth(folder):
    edit(folder, "bit_depth = 12", "bit_depth = 10")


def unknown_key(folder):
    edit(folder, "gain_e_per_dn", "gain_e_per_dm")


def no_exposure(folder):
    edit(folder, r"exposure_s = .*\n", "")


def not_a_number(folder):
    path = folder / "spectra" / "lamp.csv"
    path.write_text(re.sub(r"(?m)^550,.*$", "550,nan", path.read_text()))


def six_coplanar_points(folder):
    path = folder / "points.csv"
    rows = [line.split(",") for line in path.read_text().splitlines()]
    floor = [row for row in rows[1:] if float(row[2]) == 0][:6]
    floor += [[f"q{i}", *row[1:2], "0.00", *row[3:]] for i, row in enumerate(rows[1 : 7 - len(floor)])]
    assert len(floor) == 6
    path.write_text("\n".join(",".join(row) for row in [rows[0], *floor]) + "\n")


def path_that_leaves(folder):
    edit(folder, r'"spectra/lamp\.csv:radiance"', '"../lamp.csv:radiance"')


# How the capture is broken, and what the message must name: the file, the key or place, what is wrong.
FAULTS = {
    "truncated TIFF": (truncated_tiff, ["f550-1.tif", "truncated"]),
    "missing file": (missing_file, ["f550-1.tif", "not exist"]),
    "wrong size": (wrong_size, ["f550-1.tif", "128 x 100", "128 x 128"]),
    "wrong kind of frame": (wrong_kind, ["f550-1.tif", "uint8"]),
    "wrong bit depth": (wrong_bit_depth, ["frames/", ".tif", "1023", "bit_depth"]),
    "unknown key": (unknown_key, ["capture.toml", "gain_e_per_dm", "unknown key", "gain_e_per_dn"]),
    "band without exposure": (no_exposure, ["capture.toml", "band[0]", "exposure_s"]),
    "NaN in a spectrum": (not_a_number, ["lamp.csv", "radiance", "nan"]),
    "six coplanar points": (six_coplanar_points, ["points.csv", "plane"]),
    "path that leaves the folder": (path_that_leaves, ["capture.toml", "lamp.radiance", "../lamp.csv"]),
}


@pytest.mark.parametrize("command", ["validate", "calibrate"])
@pytest.mark.parametrize("name", FAULTS)
def test_a_broken_capture_is_one_line_of_help(name, command, capture, tmp_path, cbox):
    break_it, phrases = FAULTS[name]
    break_it(capture)
    outcome = cbox(command, capture, "--out", tmp_path / "out")
    assert_one_line_of_help(outcome, [*phrases, "expected"])
    assert {path.name for path in tmp_path.iterdir()} == {"capture"}


@pytest.mark.parametrize("command", ["validate", "calibrate", "diagnose"])
def test_a_missing_folder(command, tmp_path, cbox):
    outcome = cbox(command, tmp_path / "nowhere", "--out", tmp_path / "out")
    assert_one_line_of_help(outcome, ["nowhere", "no such folder"])
    assert not list(tmp_path.iterdir())


def test_the_program_itself_ends_without_a_traceback(tmp_path):
    """In a separate process, as a user runs it."""
    program = [sys.executable, "-c", "from cboxlab.validation.app.commands.cli import main; main()"]
    done = subprocess.run([*program, "validate", str(tmp_path / "x")], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr and done.stderr.count("\n") == 1 and done.stderr.startswith("error: ")
    assert not list(tmp_path.iterdir())


# A mistake, and what the message must name. {t} is a folder with one file, {d} the bundled capture.
MISTAKES = [
    ("validate {d} --out {t}/file", ["{t}/file", "a folder for results"]),
    ("validate {d} --out {t}/file/below", ["{t}/file/below", "a folder for results"]),
    ("validate {d} --model {t}/none.toml --out {t}/out", ["none.toml", "no such file"]),
    ("validate {d} --model {t}/file --out {t}/out", ["file", "TOML"]),
    ("render {t}/none.toml --out {t}/a.nc", ["none.toml", "no such file"]),
    ("render cornell-box --out {t}/a.jpg", ["a.jpg", ".nc"]),
    (
        "render cornell-box --out {t}/a.nc --wavelengths 700:400:10",
        ["--wavelengths", "700:400:10", "ascending"],
    ),
    ("render cornell-box --out {t}/a.nc --wavelengths 400:700:0", ["--wavelengths", "400:700:0"]),
    ("render cornell-box --out {t}/a.nc --wavelengths 400,x", ["--wavelengths", "400,x"]),
    ("render cornell-box --out {t}/a.nc --size 1_6", ["--size", "'1_6'", "a whole number"]),
    ("render cornell-box --out {t}/a.nc --percentile 9_0", ["--percentile", "'9_0'", "a number"]),
    ("render cornell-box --out {t}/a.nc --percentile=nan", ["--percentile", "'nan'", "a number"]),
    ("add {t}/model.toml veiling-glare fraction=0_3", ["fraction", "'0_3'", "a number from 0 to 0.5"]),
    ("render cornell-box --out {t}/a.nc --noise -1", ["--noise", "-1", "above 0"]),
    ("render cornell-box --out {t}/a.nc --camera {t}", ["capture.toml"]),
    ("simulate {t}/none.nc --out {t}/a.tif", ["none.nc", "no such file"]),
    ("simulate {t}/file --out {t}/a.tif", ["file", ".nc"]),
    ("simulate {t}/none.nc --out {t}/a.png", ["a.png", ".tif"]),
    ("simulate {t}/none.nc --out {t}/a.tif --camera dcs2000", ["dcs2000", "Did you mean 'dcs200'"]),
    ("simulate {t}/none.nc --out {t}/a.tif --exposure 1/0", ["--exposure", "1/0"]),
    ("capture cornell-box --out {d}", ["demo-capture", "exists already"]),
    ("capture cornell-box --out {t}/c --effects ghost", ["--effects", "--hide"]),
    ("capture cornell-box --out {t}/c --hide --effects gohst", ["gohst", "Did you mean 'ghost'"]),
    ("capture cornell-bx --out {t}/c", ["cornell-bx"]),
    ("compare {d} {t}/none.nc", ["none.nc", "no such file or folder"]),
    ("compare {t}/file {d}", ["file", ".nc"]),
    ("reveal {t}", ["sealed.json", "--hide"]),
    ("add {t}/m.toml gost", ["'gost'", "Did you mean 'ghost'"]),
    ("add {t}/m.toml ghost fraction", ["'fraction'", "key=value"]),
    ("add {t}/m.toml ghost fraction=much", ["fraction", "'much'", "a number from 0 to 0.5"]),
    ("add {t}/m.toml ghost fraction=0.9", ["fraction", "0.9", "a number from 0 to 0.5"]),
    ("add {t}/m.toml ghost strength=0.1", ["strength", "unknown parameter", "fraction"]),
    ("add {t}/m.txt ghost fraction=0.1", ["m.txt", ".toml"]),
    ("effects gost", ["'gost'", "Did you mean 'ghost'"]),
]


@pytest.mark.parametrize(("command", "phrases"), MISTAKES, ids=[command for command, _ in MISTAKES])
def test_a_mistake_is_one_line_of_help(command, phrases, tmp_path, cbox):
    (tmp_path / "file").write_text("neither a folder nor = a model")
    folders = {"t": tmp_path, "d": DEMO_CAPTURE}
    outcome = cbox(*command.format(**folders).split())
    assert_one_line_of_help(outcome, [word.format(**folders) for word in phrases])
    assert {path.name for path in tmp_path.iterdir()} == {"file"}


@pytest.mark.parametrize("arguments", [["--colour"], ["validate"], ["render", "cornell-box"], ["unheard-of"]])
def test_usage_errors_have_the_same_exit_code(arguments, cbox):
    code, out, err = cbox(*arguments)
    assert code == 2 and out == "" and "Traceback" not in err


@pytest.mark.parametrize(("text", "value"), [("0.003", 0.003), ("0.3%", 0.003), ("1/30", 1 / 30), ("2", 2.0)])
def test_numbers_as_people_write_them(text, value):
    assert console.positive_number(text, "--x") == pytest.approx(value)


@pytest.mark.parametrize("text", ["", "0", "-1", "nan", "inf", "1/0", "x", "3%%"])
def test_what_is_no_positive_number(text):
    with pytest.raises(InputError, match="--x"):
        console.positive_number(text, "--x")


def test_wavelengths_include_both_ends():
    assert np.allclose(console.wavelengths("400:700:10"), np.arange(400, 701, 10))
    assert np.allclose(console.wavelengths("450,550.5,650"), [450, 550.5, 650])
    assert np.allclose(console.wavelengths("400:700:0.3"), 400 + 0.3 * np.arange(1001))


def test_a_model_grows_and_reads_back(tmp_path, cbox):
    path = tmp_path / "model.toml"
    assert cbox("add", path, "veiling-glare", "fraction=0.02")[0] == 0
    assert cbox("add", path, "wall-reflectance", "material=red", "scale=1.1")[0] == 0
    effects = load_model(path).effects
    assert [(e.id, dict(e.values)) for e in effects] == [
        ("veiling-glare", {"fraction": 0.02}),
        ("wall-reflectance", {"material": "red", "scale": 1.1}),
    ]


def test_a_model_that_changed_meanwhile_is_not_overwritten(tmp_path, cbox, monkeypatch):
    """As if another command had added an effect while this one was fitted."""
    path = tmp_path / "model.toml"
    assert cbox("add", path, "veiling-glare", "fraction=0.02")[0] == 0
    other = path.read_bytes().replace(b"0.02", b"0.03")

    def slow(*arguments):
        path.write_bytes(other)
        return named_effect(*arguments)

    monkeypatch.setattr("cboxlab.rendering.model.named_effect", slow)
    assert_one_line_of_help(cbox("add", path, "ghost", "fraction=0.01"), "another content")
    assert path.read_bytes() == other


def test_writers_of_a_model_take_turns(tmp_path):
    order = []

    def later():
        with folder_lock(tmp_path):
            order.append("second")

    other = threading.Thread(target=later)
    with folder_lock(tmp_path):
        other.start()
        other.join(0.2)
        order.append("first")
    other.join()
    assert order == ["first", "second"]


def test_the_catalogue_is_shown(cbox):
    code, out, _ = cbox("effects")
    assert code == 0 and "veiling-glare" in out and "lamp-drift" in out
    code, out, _ = cbox("effects", "veiling-glare")
    assert code == 0 and "fraction" in out and "ISO 9358" in out and "To confirm" in out


def test_a_calibration_in_the_terminal_is_verified_by_the_command(tmp_path, cbox):
    code, out, _ = cbox("calibrate", DEMO_CAPTURE, "--out", tmp_path / "out", "--refine-geometry")
    assert code == 0
    for word in (
        "Geometry from edges",
        "focal length",
        "gain",
        "read noise",
        "C over its nominal",
        "50 of 50 points",
        "no usable [[bracket]]",
    ):
        assert word in out
    gain = float(re.search(r"gain +([\d.]+) ", out)[1])
    path = tmp_path / "out" / "calibration.json"
    record = json.loads(path.read_text())
    assert gain == pytest.approx(record["gain_e_per_dn"]["value"], abs=record["gain_e_per_dn"]["sigma"] / 5)
    code, out, _ = cbox("verify", path.parent)
    assert code == 0 and "are unchanged" in out
    path.write_text(path.read_text() + " ")
    code, out, _ = cbox("verify", path.parent)
    assert code == 1 and "calibration.json: this result has changed" in out
    assert cbox("verify", tmp_path)[0] == 2


def test_a_hidden_effect_is_made_and_revealed(tmp_path, cbox):
    """A small rough capture; the diagnosis is made up, the score is not."""
    folder = tmp_path / "blind"
    rough = ("--size", 32, "--seed", 9, "--noise", "5%")
    code, out, err = cbox("capture", "cornell-box", "--out", folder, *rough, "--hide", "--effects", "ghost,smear")
    assert code == 0 and "ghost" not in err and "smear" not in err
    assert "ghost" not in out and "smear" not in out
    assert load_capture(folder).shape == (32, 32)
    ((name, values),) = open_seal(folder).effects
    assert name in ("ghost", "smear") and 0 < values["fraction"] < 0.05
    code, out, _ = cbox("reveal", folder)
    assert code == 0 and name in out
    results = {
        "ranking": [{"effect": name, "parameters": {"fraction": 1.5 * values["fraction"]}}],
        "selected": [name],
    }
    (tmp_path / "diagnosis.json").write_text(json.dumps(results))
    code, out, _ = cbox("reveal", folder, "--diagnosis", tmp_path / "diagnosis.json")
    assert code == 0 and "selected exactly the hidden effects" in out and "+50.0%" in out


def test_a_capture_is_photographed_by_the_camera_given(tmp_path, cbox):
    camera = replace(cornell_camera(32), height_px=24)
    write_camera(tmp_path / "camera.json", camera)
    rough = ("--camera", tmp_path / "camera.json", "--seed", 9, "--noise", "5%")
    code, out, _ = cbox("capture", "cornell-box", "--out", tmp_path / "own", *rough)
    assert code == 0 and "32 x 24 px" in out
    assert load_capture(tmp_path / "own").shape == (24, 32)
    points = np.genfromtxt(tmp_path / "own" / "points.csv", delimiter=",", names=True)
    photo, camera_seen = (
        np.stack([points[n] for n in names], axis=-1) for names in (("x_mm", "y_mm", "z_mm"), ("u_px", "v_px"))
    )
    off = np.linalg.norm(camera.project(photo) - camera_seen, axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.5


def test_a_capture_repeats_by_its_seed(tmp_path, cbox):
    for name in ("a", "b"):
        arguments = (
            "capture",
            "cornell-box",
            "--out",
            tmp_path / name,
            "--size",
            16,
            "--seed",
            4,
            "--noise",
            "20%",
        )
        assert cbox(*arguments)[0] == 0
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file())
    assert len(files) > 40
    assert all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files)


def test_calibrate_init_writes_a_first_manifest(tmp_path, cbox):
    tifffile.imwrite(tmp_path / "f550_2s_0.tif", np.full((8, 10), 700, np.uint16))
    code, out, _ = cbox("calibrate", "--init", tmp_path)
    assert code == 0 and "capture.toml" in out and "[geometry]" in out and "does not name" not in out
    assert "• [camera]: bit_depth = 12" in out
    code, _, err = cbox("calibrate", tmp_path, "--out", tmp_path / "out")
    assert code == 2 and "bit_depth" in err and not (tmp_path / "out").exists()
    code, _, err = cbox("calibrate", "--init", tmp_path)
    assert code == 2 and "exists already" in err


def test_calibrate_init_names_the_files_it_left_out(tmp_path, cbox):
    tifffile.imwrite(tmp_path / "f550_2s_0.tif", np.full((8, 10), 700, np.uint16))
    (tmp_path / "notes.txt").write_text("taken on a Saturday")
    code, out, _ = cbox("calibrate", "--init", tmp_path, "--json", tmp_path / "init.json")
    assert code == 0 and "Files that capture.toml does not use:" in out and "• notes.txt: " in out
    assert [item["file"] for item in json.loads((tmp_path / "init.json").read_text())["left_out"]] == ["notes.txt"]


@pytest.mark.parametrize("command", ["diagnose", "studio"])
def test_what_needs_a_compiler_says_so_before_it_computes(cbox, monkeypatch, command):
    monkeypatch.setattr("cboxlab.rendering.device.variant.compiled", lambda: False)
    code, out, errors = cbox(command, DEMO_CAPTURE)
    assert code == 2 and not out
    expected = "no compiled variant; expected LLVM 16 or newer, or a GPU. Debian/Ubuntu: apt install libllvm19"
    assert " ".join(errors.split()) == f"error: cbox {command}: found {expected}"
