"""A model is a value: what its files become afterwards changes nothing."""

import shutil
from pathlib import Path

import cboxlab.scenes
import pytest
from cboxlab.rendering.model import Model, load_model, model_text, write_model
from cboxlab.scenes import load_scene
from cboxlab.utils.errors import InputError


@pytest.fixture
def model_file(tmp_path):
    """A model of a scene file: the published box under another name."""
    shutil.copytree(Path(cboxlab.scenes.__file__).parent / "data", tmp_path / "box")
    (tmp_path / "box" / "cornell-box.toml").rename(tmp_path / "box" / "mine.toml")
    path = tmp_path / "model.toml"
    path.write_text('format = "model/1"\nscene = "box/mine.toml"\n')
    return path


def test_an_edited_and_a_deleted_scene_file_leave_a_model_as_it_was(model_file):
    model = load_model(model_file)
    area = model.scene.lamp.surface.areas_mm2.sum()
    scene = Path(model.scene.origin.reference)
    scene.write_text(scene.read_text().replace("343", "300"))
    assert model.scene.lamp.surface.areas_mm2.sum() == area
    shutil.rmtree(scene.parent)
    assert model.scene.lamp.surface.areas_mm2.sum() == area
    with pytest.raises(InputError):
        load_model(model_file)


def test_a_model_of_a_scene_in_memory_writes_the_scene_next_to_it(tmp_path):
    box = load_scene("cornell-box").with_reflectance("red", 0.3)
    model = Model(box, name="red 0.3").with_effect("veiling-glare", fraction=0.01)
    write_model(tmp_path / "model.toml", model)
    copy = load_model(tmp_path / "model.toml")
    assert copy.scene.origin.reference == str(tmp_path / "model-scene.toml")
    assert copy.scene.materials["red"].reflectance.at(550.0) == 0.3
    assert [(e.id, dict(e.values)) for e in copy.effects] == [("veiling-glare", {"fraction": 0.01})]
    assert copy.files[0] == tmp_path / "model-scene.toml" and len(copy.files) == len(list(tmp_path.iterdir())) - 1


@pytest.mark.parametrize("text", ['format = "scene/1"\n', 'format = "capture/1"\n', "", "["])
def test_a_model_replaces_nothing_but_a_model(tmp_path, text):
    path = tmp_path / "model.toml"
    path.write_text(text)
    with pytest.raises(InputError, match="model file"):
        write_model(path, Model())
    assert path.read_text() == text
    path.unlink()
    write_model(path, Model())
    write_model(path, Model(name="another"))
    assert load_model(path).name == "another"


@pytest.mark.parametrize(
    ("effect", "values", "text"),
    [
        ("glos", {}, "Did you mean 'gloss'"),
        ("veiling-glare", {"fraction": 2.0}, "fraction"),
        ("veiling-glare", {"fractoin": 0.1}, "fraction"),
        ("none.toml", {}, "none.toml"),
        (3, {}, "found 3"),
    ],
)
def test_a_wrong_effect_is_one_input_error(effect, values, text):
    with pytest.raises(InputError) as error:
        Model().with_effect(effect, **values)
    assert text in str(error.value)


def test_the_text_of_a_model_in_memory_says_so():
    """Provenance of cubes and maps holds the model's text."""
    model = Model(load_scene("cornell-box").with_reflectance("red", 0.3))
    assert 'scene = "in memory: cornell-box"' in model_text(model)
