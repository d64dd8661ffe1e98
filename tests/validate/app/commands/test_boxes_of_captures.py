"""Which box a capture shows, and which one models and commands take for it."""

import shutil
from pathlib import Path

import pytest
from cboxlab import scenes
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.rendering.model.model_file import load_model
from cboxlab.utils.errors import InputError
from cboxlab.validation.app.commands import console
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE
from cboxlab.validation.capture_checks import with_scene_checks
from helpers.captures.calibrations import quick_calibration
from helpers.programs.command_line import assert_one_line_of_help


@pytest.mark.parametrize("capture_folder", [False, True])
def test_a_capture_of_another_box_is_refused_before_the_work(capture_folder, tmp_path, capsys):
    """It was compared with the published box for minutes, and was unknown."""
    capture = shutil.copytree(DEMO_CAPTURE, tmp_path / "other")
    manifest = capture / "capture.toml"
    manifest.write_text(manifest.read_text().replace('scene = "cornell-box"', 'scene = "my-box"'))
    model = tmp_path / "model.toml"
    model.write_text('format = "model/1"\nscene = "cornell-box"\n')
    model, captures = console.load_inputs(model if capture_folder else None, [DEMO_CAPTURE, capture])
    assert model.scene.origin.reference == "cornell-box"
    assert [loaded.folder for loaded in captures] == [DEMO_CAPTURE, capture]
    err = capsys.readouterr().err
    expected = f'{manifest}: scene is "my-box", but the model is "cornell-box". Give the box with --model.\n'
    assert err == ("" if capture_folder else expected)


@pytest.fixture
def own_capture(tmp_path):
    """The bundled capture with another scene file: the published box, its short block 3 mm higher."""
    capture = shutil.copytree(DEMO_CAPTURE, tmp_path / "own")
    data = Path(scenes.__file__).parent / "data"
    for table in data.glob("*.csv"):
        shutil.copy(table, capture)
    (capture / "box.toml").write_text((data / "cornell-box.toml").read_text().replace("165.0", "168.0"))
    manifest = capture / "capture.toml"
    manifest.write_text(manifest.read_text().replace('scene = "cornell-box"', 'scene = "box.toml"'))
    return capture


def test_a_captures_own_scene_is_its_model(own_capture, tmp_path, monkeypatch, capsys):
    """Whatever folder the program runs in; a misspelt file is no published box."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "box.toml").write_text("another file")
    assert load_capture(own_capture).scene is not None
    model, _ = console.load_inputs(None, [own_capture])
    assert (model.scene.origin.reference, capsys.readouterr().err) == (str(own_capture / "box.toml"), "")
    with pytest.raises(InputError, match="captures of one box"):
        console.load_inputs(None, [DEMO_CAPTURE, own_capture])
    (own_capture / "box.toml").rename(own_capture / "bxo.toml")
    with pytest.raises(InputError, match=r"scene: found 'box.toml', which does not exist"):
        console.load_inputs(None, [own_capture])
    (suspicion,) = with_scene_checks(quick_calibration(own_capture)).suspicions
    assert suspicion.what == "the scene file cannot be read"


def test_an_unknown_scene_leaves_checks_out(own_capture):
    manifest = own_capture / "capture.toml"
    manifest.write_text(manifest.read_text().replace('scene = "box.toml"', 'scene = "lab-box"'))
    calibration = with_scene_checks(quick_calibration(own_capture))
    assert any("checks against the box were left out" in note for note in calibration.notes)


def test_a_scene_file_is_a_model_and_not_overwritten_by_one(tmp_path, cbox):
    shutil.copytree(Path(scenes.__file__).parent / "data", tmp_path / "box")
    scene = tmp_path / "box" / "cornell-box.toml"
    model = load_model(scene)
    assert model.effects == () and model.scene.surfaces[0].name == "floor"
    before = scene.read_bytes()
    assert_one_line_of_help(cbox("add", scene, "ghost", "fraction=0.01"), "a scene file")
    assert scene.read_bytes() == before
    assert cbox("add", tmp_path / "m.toml", "ghost", "fraction=0.01", "--scene", scene)[0] == 0
    grown = load_model(tmp_path / "m.toml")
    assert grown.scene.origin.reference == str(scene) and [e.id for e in grown.effects] == ["ghost"]
    text = (tmp_path / "m.toml").read_text()
    again = cbox("add", tmp_path / "m.toml", "ghost", "fraction=0.01", "--scene", scene)
    assert_one_line_of_help(again, "--scene")
    assert (tmp_path / "m.toml").read_text() == text


def test_a_models_scene_stays_where_it_was(tmp_path, cbox):
    """A model names its scene relative to itself, and still does after an effect was added."""
    shutil.copytree(Path(scenes.__file__).parent / "data", tmp_path / "boxes")
    (tmp_path / "boxes" / "cornell-box.toml").rename(tmp_path / "boxes" / "mine.toml")
    (tmp_path / "model.toml").write_text('format = "model/1"\nscene = "boxes/mine.toml"\n')
    assert cbox("add", tmp_path / "model.toml", "ghost", "fraction=0.01")[0] == 0
    assert 'scene = "boxes/mine.toml"' in (tmp_path / "model.toml").read_text()
