"""Effect files: written from a diagnosis by a command, named by a model, refused where they are none."""

import json
import shutil

import numpy as np
import pytest
from cboxlab.rendering.fitted_fields import load_effect_file
from cboxlab.rendering.model import load_model, write_model
from cboxlab.utils.errors import InputError
from cboxlab.validation.diagnose.explain import explain
from cboxlab.validation.report.explanation import explanation_record
from helpers.captures.small_excess import BANDS, SIGMA, SIZE, small_excess
from helpers.programs.command_line import assert_one_line_of_help

ROW_NOISE = SIGMA * np.random.default_rng(2).normal(0, 1.5, (1, SIZE, 1)) * np.ones((BANDS, 1, 1))


@pytest.fixture(scope="module")
def record():
    return explanation_record(explain(small_excess(ROW_NOISE)))


def _diagnosis(folder, record, selected=("unknown",)):
    path = folder / "diagnosis.json"
    path.write_text(json.dumps({"selected": list(selected), "explanation": record}))
    return path


@pytest.fixture
def written(record, tmp_path, monkeypatch, cbox):
    """A folder with rows.toml, made by the command."""
    monkeypatch.chdir(tmp_path)
    code, out, _ = cbox("effects", "--new", "rows", "--from", _diagnosis(tmp_path, record))
    assert code == 0
    assert "cbox add model.toml rows.toml --fit CAPTURE" in " ".join(out.split())
    return tmp_path


def test_a_model_names_the_file_wherever_it_lies(written, cbox):
    code, out, _ = cbox("add", "model.toml", "rows.toml")
    assert (code, "amplitude = 1" in out) == (0, True)
    assert 'id = "rows.toml"' in (written / "model.toml").read_text()
    assert cbox("add", "model.toml", "veiling-glare", "fraction=0.01")[0] == 0
    (written / "below").mkdir()
    model = load_model(written / "model.toml")
    assert [(effect.id, effect.stage) for effect in model.effects] == [
        ("rows", "counts"),
        ("veiling-glare", "optics"),
    ]
    write_model(written / "below" / "other.toml", model)
    assert 'id = "../rows.toml"' in (written / "below" / "other.toml").read_text()
    assert load_model(written / "below" / "other.toml").effects[0].values == {"amplitude": 1.0}
    shutil.move(written / "rows.toml", written / "elsewhere.toml")
    with pytest.raises(InputError, match="no such file"):
        load_model(written / "model.toml")


def test_amplitudes_beyond_their_bounds_are_refused(written, cbox):
    outcome = cbox("add", "model.toml", "rows.toml", "amplitude=9")
    assert_one_line_of_help(outcome, ["amplitude", "9", "-5 to 5"])


@pytest.mark.parametrize(
    ("changes", "phrases"),
    [
        ({"family": "none"}, ["explanation.family", "'none'"]),
        ({"field": None}, ["explanation.field", "Diagnose the capture again"]),
        ({"field": {"acts": "magic"}}, ["field.acts", "magic"]),
    ],
)
def test_an_explanation_without_a_field_gives_no_effect(record, changes, phrases, tmp_path, monkeypatch, cbox):
    monkeypatch.chdir(tmp_path)
    diagnosis = _diagnosis(tmp_path, {**record, **changes})
    assert_one_line_of_help(cbox("effects", "--new", "rows", "--from", diagnosis), phrases)
    assert not (tmp_path / "rows.toml").exists()


@pytest.mark.parametrize("name", ["veiling-glare", "My Effect", "rows/../../x y"])
def test_names_that_are_none_or_taken_are_refused(record, name, tmp_path, monkeypatch, cbox):
    monkeypatch.chdir(tmp_path)
    outcome = cbox("effects", "--new", name, "--from", _diagnosis(tmp_path, record))
    assert_one_line_of_help(outcome, ["--new", "an unused name"])


def test_nothing_is_overwritten(written, cbox):
    outcome = cbox("effects", "--new", "rows", "--from", "diagnosis.json")
    assert_one_line_of_help(outcome, ["rows.toml", "there already"])


def test_both_options_belong_together(tmp_path, cbox):
    assert_one_line_of_help(cbox("effects", "--new", "rows"), ["--new NAME --from diagnosis.json"])


def test_effects_that_cannot_be_separated_are_named(record, tmp_path, monkeypatch, cbox):
    monkeypatch.chdir(tmp_path)
    diagnosis = _diagnosis(tmp_path, {**record, "told_apart": False, "runner_up": "sensor-gain"})
    code, out, _ = cbox("effects", "--new", "rows", "--from", diagnosis)
    assert code == 0
    assert "does not distinguish sensor-offset from sensor-gain" in " ".join(out.split())


@pytest.mark.parametrize(
    ("old", "new", "phrase"),
    [
        ('format = "effect/1"', 'format = "effect/2"', "'effect/1'"),
        ('kind = "rows"', 'kind = "columns"\norder = 99', "order"),
        ("size = [48, 48]", "size = [47, 48]", "of 47 numbers"),
        ('acts = "offset"', 'acts = "reflectance"', "field.spectrum"),
    ],
)
def test_a_damaged_file_is_refused_with_the_place(written, old, new, phrase):
    text = (written / "rows.toml").read_text()
    assert old in text
    (written / "rows.toml").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=r"rows\.toml") as caught:
        load_effect_file(written / "rows.toml")
    assert phrase in str(caught.value)
