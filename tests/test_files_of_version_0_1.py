"""Files that version 0.1 wrote are opened by this version, with what they held.

They lie in ``version_0_1`` and never change. A format that can no longer be read names the command that converts it.
"""

import json
import shutil

import cboxlab
import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.correction import measure_noise, read_darks
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.export import read_camera
from cboxlab.rendering.files import read_cube
from cboxlab.rendering.fitted_fields import load_effect_file
from cboxlab.rendering.model import load_model
from cboxlab.scenes.lens import Lens
from cboxlab.scenes.scene_file import load_scene
from cboxlab.validation.api import verify
from cboxlab.validation.app.studio.autosave import AUTOSAVE_FOLDER, unsaved_studies
from cboxlab.validation.app.studio.first_entries import FirstEntries, read_entries, store_entries
from cboxlab.validation.compare_renders.stored_references import read_reference, require_same_light
from cboxlab.validation.report import read_trend_result
from cboxlab.validation.study import read_study
from cboxlab.validation.synthetic.blind import open_seal, read_diagnosis
from helpers.places import ROOT

OLD = ROOT / "tests" / "version_0_1"
METRICS = json.loads((OLD / "result" / "metrics.json").read_text())


def test_a_capture():
    capture = load_capture(OLD / "capture")
    assert [band.id for band in capture.manifest.band] == ["f550", "f650"]
    assert capture.frames(capture.manifest.band[0]).shape == (2, 32, 32)
    noise = measure_noise(capture, read_darks(capture))
    assert noise.gain_e_per_dn == pytest.approx(12.0, abs=4 * noise.gain_sigma)
    assert noise.read_noise_e == pytest.approx(10.0, abs=4 * noise.read_noise_sigma)


def test_a_model_and_a_scene():
    model = load_model(OLD / "model.toml")
    assert (model.name, model.render.noise, model.render.seed) == ("glossy box", 0.5, 3)
    values = {effect.id: dict(effect.values) for effect in model.effects}
    assert values["veiling-glare"] == {"fraction": 0.004}
    assert values["gloss"]["material"] == "white" and values["gloss"]["roughness"] == 0.2
    assert load_scene(OLD / "scene.toml").material("white").reflectance.at([450.0, 700.0]) == pytest.approx(0.7)


def test_a_study_with_its_history():
    study = read_study(OLD / "study.json")
    assert study.captures == ((OLD / "capture").resolve(),)
    assert [len(state.effects) for state in study.history.states] == [0, 2] and study.history.at == 1
    assert [effect.id for effect in study.model.effects] == ["veiling-glare", "gloss"]


def test_a_diagnosis():
    diagnosis = read_diagnosis(OLD / "diagnosis.json")
    assert diagnosis["ranking"][0]["effect"] == "veiling-glare"
    assert diagnosis["ranking"][0]["parameters"]["fraction"] == pytest.approx(0.00407, abs=1e-5)


def test_the_answer_of_a_blind_capture():
    answer = open_seal(OLD / "capture")
    assert answer.effects == (("veiling-glare", {"fraction": 0.004}),)


def test_the_figures_of_a_result():
    result = read_trend_result(OLD / "result")
    assert result.numbers["χ² per degree of freedom"][0] == pytest.approx(METRICS["chi2_per_dof"])


def test_a_camera_file_with_its_lens():
    camera = read_camera(OLD / "camera.json")
    assert camera.lens == Lens(k2=1e-3, p1=2e-4) and camera.k1 == pytest.approx(-0.01897, abs=1e-5)
    # the point on the axis
    axis = camera.position_mm + 100 * camera.rotation[2]
    np.testing.assert_allclose(camera.project(axis[None])[0], camera.principal_point_px, atol=1e-6)


def test_unsaved_work_of_the_workbench(tmp_path):
    """A study, and entries for a first manifest: their name is by the folder of frames, which is elsewhere now."""
    shutil.copytree(OLD / "capture", tmp_path / "capture")
    unsaved = tmp_path / AUTOSAVE_FOLDER
    shutil.copytree(OLD / "workbench" / "unsaved", unsaved)
    (work,) = unsaved_studies(tmp_path)
    assert work["name"] == "capture"
    study = read_study(tmp_path / work["path"] / "study.json")
    assert study.captures == ((tmp_path / "capture").resolve(),) and study.history.can_undo
    assert load_model(tmp_path / work["path"] / "model.toml").name == "glossy box"

    frames = tmp_path / "frames"
    store_entries(tmp_path, frames, FirstEntries())
    (stored,) = set(unsaved.glob("first-capture-*.json"))
    shutil.move(unsaved / "first-capture.json", stored)
    entries = read_entries(tmp_path, frames)
    assert [(entry.where, entry.key, entry.value) for entry in entries.values] == [
        ("[camera]", "bit_depth", "12"),
        ("", "scene", "cornell-box"),
    ]
    assert [(role.file, role.kind, role.filter, role.exposure_s) for role in entries.roles] == [
        ("IMG_0001.tif", "scene", "f550", 0.6),
        ("IMG_0002.tif", "dark", "", None),
    ]


def test_an_effect_file_acts():
    effect = load_effect_file(OLD / "gradient.toml")
    applied = apply_checked(effect, {"amplitude": 1.0}, "model")
    assert effect.id == "gradient" and effect.title == "a gradient"
    assert applied.stage in ("optics", "counts") and applied.values["amplitude"] == 1.0


def test_a_stored_reference_is_compared_with():
    reference = read_reference(OLD / "reference.json")
    assert reference.means["band: 450"] == pytest.approx(0.02272715763872724)
    assert reference.versions["cboxlab"] == "0.1.0" and len(reference.shapes) > 3
    require_same_light(reference, reference)


def test_cubes_of_every_format_hold_the_same():
    cube = read_cube(OLD / "cube.nc")
    assert cube["wavelength"].values.tolist() == [450.0, 650.0] and cube.sizes["x"] == 16
    for name in ("cube.exr", "cube.hdr"):
        np.testing.assert_allclose(read_cube(OLD / name)["radiance"].values, cube["radiance"].values, rtol=1e-6)


def test_results_are_verified_by_their_manifest():
    assert verify(OLD / "cube.nc").sound


def test_a_data_set():
    pictures = cboxlab.open_dataset(OLD / "dataset")
    assert len(pictures) == 1 and pictures.index[0]["part"] == "train"
    picture = pictures[0]
    assert picture["radiance"].sizes["x"] == 8 and "depth" in picture
    assert np.isfinite(picture["depth"].values[:, 1:7]).all()
    assert len(pictures.model(0).scene.surfaces) > 5


@pytest.mark.parametrize("content", ["[]", '[["a", 1]]', "3", "null"])
def test_a_data_sets_json_without_an_object_is_refused(tmp_path, content):
    shutil.copytree(OLD / "dataset", tmp_path / "dataset")
    (tmp_path / "dataset" / "boxes" / "000000" / "box.json").write_text(content)
    with pytest.raises(cboxlab.InputError, match=r"box\.json.*JSON without an object"):
        cboxlab.open_dataset(tmp_path / "dataset").drawn_values(0)
    (tmp_path / "dataset" / "dataset.json").write_text(content)
    with pytest.raises(cboxlab.InputError, match=r"dataset\.json.*JSON without an object"):
        cboxlab.open_dataset(tmp_path / "dataset")


def test_an_index_of_eight_gigabytes_or_with_large_numbers_is_soon_read_or_refused(tmp_path):
    shutil.copytree(OLD / "dataset", tmp_path / "dataset")
    index = tmp_path / "dataset" / "index.csv"
    index.write_text(index.read_text().replace(",29343,", f",{'9' * 30},"))
    assert cboxlab.open_dataset(tmp_path / "dataset").index[0]["bytes"] == 10**30 - 1
    with index.open("r+b") as file:
        file.truncate(2**33)  # a file with a hole, which takes no room
    with pytest.raises(cboxlab.InputError, match="bytes"):
        cboxlab.open_dataset(tmp_path / "dataset")


@pytest.mark.parametrize(
    ("before", "after", "fault"),
    [
        ("boxes/000000/main.nc", "../main.nc", "leaves the folder"),
        ("boxes/000000/main.nc", "/etc/passwd", "a path inside the folder"),
        ("boxes/000000/model.toml", "../../model.toml", "leaves the folder"),
        (",main,", ",../../main,", "camera '../../main'"),
        (",file,", ",other,", "a row without file"),
        (",boxes/000000/model.toml", ",", "a row without model"),
    ],
)
def test_an_index_that_leads_out_of_its_data_set_is_refused(tmp_path, before, after, fault):
    shutil.copytree(OLD / "dataset", tmp_path / "dataset")
    index = tmp_path / "dataset" / "index.csv"
    index.write_text(index.read_text().replace(before, after))
    with pytest.raises(cboxlab.InputError, match=fault):
        pictures = cboxlab.open_dataset(tmp_path / "dataset")
        pictures.model(0), pictures[0]


def test_a_version_that_comes_later_is_named(tmp_path):
    """A file of a format that does not exist yet: which formats this version reads."""
    shutil.copytree(OLD / "capture", tmp_path / "capture")
    path = tmp_path / "capture" / "capture.toml"
    path.write_text(path.read_text().replace("capture/1", "capture/9"))
    with pytest.raises(cboxlab.InputError, match="capture/1"):
        load_capture(tmp_path / "capture")
    model = tmp_path / "model.toml"
    model.write_text((OLD / "model.toml").read_text().replace("model/1", "model/9"))
    with pytest.raises(cboxlab.InputError, match="model/1"):
        load_model(model)
