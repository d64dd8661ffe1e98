"""manifest.json: what was made of what, and whether either has changed since."""

import json
import shutil

import pytest
from cboxlab.rendering.model import Model
from cboxlab.scenes import load_scene
from cboxlab.utils.errors import InputError
from cboxlab.validation.api import verify, write_manifest
from helpers.places import ROOT


@pytest.fixture
def result(tmp_path):
    """A folder of two results, made of a folder with two files and of one more."""
    results, capture, model = tmp_path / "out", tmp_path / "capture", tmp_path / "m.toml"
    for path in (
        results / "maps" / "a.exr",
        results / "metrics.json",
        capture / "frames" / "f.tif",
        capture / "c.toml",
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(path.name.encode())
    model.write_text("model")
    write_manifest(results, [results / "maps", results / "metrics.json"], [capture, model, tmp_path / "none"], seed=7)
    return results, capture, model


def test_unchanged_results_are_sound(result):
    verification = verify(result[0])
    assert verification.sound and not verification.lines()
    assert (verification.outputs, verification.inputs) == (2, 3)
    content = json.loads((result[0] / "manifest.json").read_text())
    assert content["seed"] == 7 and {"python", "numpy", "mitsuba", "cboxlab"} <= set(content["versions"])


def test_each_kind_of_change_is_named(result):
    results, capture, model = result
    (results / "metrics.json").write_bytes(b"metrics.jsoN")
    (results / "maps" / "a.exr").unlink()
    (capture / "frames" / "f.tif").write_bytes(b"g.tif")
    model.unlink()
    verification = verify(results)
    assert verification.changed_outputs == ("metrics.json",) and verification.missing_outputs == ("maps/a.exr",)
    assert [p.split("/")[-1] for p in verification.changed_inputs] == ["f.tif"]
    assert [p.split("/")[-1] for p in verification.missing_inputs] == ["m.toml"]
    assert len(verification.lines()) == 4 and not verification.sound


def test_what_a_scene_file_names_is_an_input(tmp_path):
    """A paint's table and a block's mesh next to the scene file: a change in them is reported."""
    shutil.copytree(ROOT / "scenes" / "data", tmp_path / "box")
    scene = tmp_path / "box" / "cornell-box.toml"
    (tmp_path / "box" / "ball.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n")
    block = '[[surface]]\nname = "ball"\nmaterial = "white"\nmesh = "ball.obj"\n'
    scene.write_text(f"{scene.read_text()}\n{block}")
    write_manifest(tmp_path, [], Model(load_scene(scene)).files)
    tables = [path.name for path in (tmp_path / "box").glob("*.csv")]
    for name in ("ball.obj", *tables):
        path = tmp_path / "box" / name
        path.write_text(path.read_text() + " ")
    members = {path.split("/")[-1] for path in verify(tmp_path).changed_inputs}
    assert tables and members == {"ball.obj", *tables}


@pytest.mark.parametrize(
    "content", [[], {}, {"format": "result-manifest/1", "inputs": {}, "outputs": {"../x": {"sha256": ""}}}]
)
def test_what_is_no_manifest_is_refused(tmp_path, content):
    (tmp_path / "manifest.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"manifest\.json"):
        verify(tmp_path)
