"""A sealed answer cannot change unnoticed, drawn effects stay physical, and a score says what was right."""

import json

import numpy as np
import pytest
from cboxlab.rendering.chain.stages import PHOTOGRAPHED
from cboxlab.rendering.effects import AppliedEffect, apply_checked, catalogue
from cboxlab.rendering.synthetic import band_filters
from cboxlab.scenes import cornell_box
from cboxlab.utils.errors import InputError
from cboxlab.validation.synthetic.blind import Answer, draw_effect, open_seal, read_diagnosis, score, seal
from helpers.scenes.boxes import box_with_lamp

BANDS = tuple(band_filters())


@pytest.fixture
def sealed(tmp_path):
    """A folder with a file in it, sealed with one effect; and the hash."""
    folder = tmp_path / "capture"
    (folder / "frames").mkdir(parents=True)
    (folder / "frames" / "a.tif").write_bytes(bytes(range(100)))
    effect = apply_checked("veiling-glare", {"fraction": 0.0125}, "test")
    return folder, seal(folder, [effect], np.random.default_rng(4))


def test_the_answer_comes_back_and_is_not_to_be_read(sealed):
    folder, digest = sealed
    assert open_seal(folder).effects == (("veiling-glare", {"fraction": 0.0125}),)
    hidden = (folder / "answer.sealed").read_bytes() + (folder / "sealed.json").read_bytes()
    assert b"glare" not in hidden and b"0.0125" not in hidden
    assert digest in (folder / "sealed.json").read_text()


def test_equal_answers_have_different_hashes(sealed, tmp_path):
    """Otherwise a table of hashes of all answers would open every seal."""
    folder, digest = sealed
    effect = apply_checked("veiling-glare", {"fraction": 0.0125}, "test")
    assert seal(folder, [effect], np.random.default_rng(5)) != digest


def test_a_changed_answer_is_noticed(sealed):
    folder, _ = sealed
    path = folder / "answer.sealed"
    content = bytearray(path.read_bytes())
    content[30] = ord("A") if content[30] != ord("A") else ord("B")
    path.write_bytes(bytes(content))
    with pytest.raises(InputError, match=r"answer\.sealed.*differs from the sealed"):
        open_seal(folder)


def test_a_changed_capture_is_noticed(sealed):
    folder, _ = sealed
    (folder / "frames" / "a.tif").write_bytes(bytes(reversed(range(100))))
    with pytest.raises(InputError, match="files that differ"):
        open_seal(folder)


def test_a_new_seal_over_the_old_one_has_another_hash(sealed):
    """Who kept the hash notices that answer and seal were both replaced."""
    folder, digest = sealed
    other = seal(folder, [apply_checked("ghost", {"fraction": 0.01}, "test")], np.random.default_rng(4))
    assert open_seal(folder).effects[0][0] == "ghost"
    assert other == open_seal(folder).sha256 != digest


@pytest.mark.parametrize(("which", "code"), [("given", 0), ("none", 0), ("other", 1)])
def test_the_stated_hash_decides_whether_the_answer_is_opened(sealed, cbox, which, code):
    folder, digest = sealed
    options = {"given": ["--hash", digest.upper()], "none": [], "other": ["--hash", "0" * 64]}[which]
    record, out, err = cbox("reveal", folder, *options)
    assert record == code
    assert digest in (err if code else out)
    assert ("veiling-glare" in out) == (code == 0)
    assert ("did not compare it" in out) == (which == "none")


@pytest.mark.parametrize("value", [[1], {"a": 1}, None, True, "x", 1e300])
def test_a_crafted_answer_is_refused(sealed, value):
    folder, _ = sealed
    crafted = AppliedEffect(catalogue()["veiling-glare"], {"fraction": value})
    seal(folder, [crafted], np.random.default_rng(4))
    with pytest.raises(InputError, match=r"answer\.sealed.*another format"):
        open_seal(folder)


@pytest.mark.parametrize("value", ["[1]", "{}", "true", "1e999", "NaN"])
def test_a_crafted_diagnosis_is_refused(tmp_path, value):
    entry = f'{{"effect": "ghost", "parameters": {{"fraction": {value}}}}}'
    (tmp_path / "d.json").write_text(f'{{"ranking": [{entry}], "selected": []}}')
    with pytest.raises(InputError, match=r"d\.json"):
        read_diagnosis(tmp_path / "d.json")


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"sha256_of_salt_and_answer": 1'])
def test_what_is_no_seal_is_named(sealed, content):
    folder, _ = sealed
    (folder / "sealed.json").write_text(content)
    with pytest.raises(InputError, match="sealed"):
        open_seal(folder)


def test_a_capture_without_a_seal_is_named(tmp_path):
    with pytest.raises(InputError, match=r"sealed\.json.*hidden effect"):
        open_seal(tmp_path)


def test_drawn_effects_are_physical_and_never_nothing():
    generator = np.random.default_rng(0)
    effects = [draw_effect(generator, cornell_box(), BANDS) for _ in range(400)]
    possible = {name for name, effect in catalogue().items() if effect.stage in PHOTOGRAPHED}
    # Each of n effects misses 400 draws with probability (1 - 1/n)^400, below 1e-5 for n up to 35.
    assert {effect.id for effect in effects} == possible
    for effect in effects:
        apply_checked(effect.id, effect.values, "test")  # within its bounds
        numbers = [p for p in effect.effect.parameters if not p.choices and p.null is not None]
        assert all(effect.values[p.name] != p.null for p in numbers)


def test_effects_are_drawn_on_what_the_box_and_the_capture_hold():
    box, generator = box_with_lamp(0.5), np.random.default_rng(1)
    effects = [draw_effect(generator, box, ("g1", "g2")) for _ in range(300)]
    assert {effect.values["material"] for effect in effects if "material" in effect.values} == {"grey"}
    assert {effect.values["band"] for effect in effects if "band" in effect.values} == {"g1", "g2"}
    assert not any("block" in effect.values for effect in effects)
    with pytest.raises(InputError, match="block-"):
        draw_effect(generator, box, ("g1", "g2"), ["block-pose"])


def test_only_allowed_effects_are_drawn():
    generator = np.random.default_rng(0)
    assert {draw_effect(generator, cornell_box(), BANDS, ["ghost", "smear"]).id for _ in range(50)} == {
        "ghost",
        "smear",
    }
    with pytest.raises(InputError, match=r"'gohst'.*Did you mean 'ghost'"):
        draw_effect(generator, cornell_box(), BANDS, ["gohst"])


HIDDEN = Answer((("veiling-glare", {"fraction": 0.01}),), "")


def diagnosis(ranking, selected):
    return {"ranking": [{"effect": e, "parameters": p} for e, p in ranking], "selected": selected}


def test_a_right_diagnosis_scores():
    result = score(HIDDEN, diagnosis([("veiling-glare", {"fraction": 0.011}), ("ghost", {})], ["veiling-glare"]))
    assert result.first and result.exact and not result.falsely_selected
    assert result.effects[0].rank == 1 and result.effects[0].selected
    assert result.effects[0].errors["fraction"] == pytest.approx(0.1)


def test_a_wrong_first_answer_scores_by_rank():
    outcome = diagnosis([("dark-offset", {"dn": 3.0}), ("veiling-glare", {"fraction": 0.005})], ["dark-offset"])
    result = score(HIDDEN, outcome)
    assert not result.first and not result.exact
    assert result.falsely_selected == ("dark-offset",)
    assert result.effects[0].rank == 2 and not result.effects[0].selected
    assert result.effects[0].errors["fraction"] == pytest.approx(-0.5)


def test_a_name_is_right_or_wrong():
    truth = Answer((("wall-reflectance", {"material": "red", "scale": 1.1}),), "")
    fitted = [("wall-reflectance", {"material": "green", "scale": 1.05})]
    errors = score(truth, diagnosis(fitted, ["wall-reflectance"])).effects[0].errors
    assert errors["material"] == float("inf")
    assert errors["scale"] == pytest.approx(-0.5)


def test_where_nothing_is_hidden_nothing_may_be_selected():
    nothing = Answer((), "")
    assert score(nothing, diagnosis([("ghost", {"fraction": 1e-5})], [])).first
    alarm = score(nothing, diagnosis([("ghost", {"fraction": 1e-3})], ["ghost"]))
    assert not alarm.first and not alarm.exact and alarm.falsely_selected == ("ghost",)


@pytest.mark.parametrize(
    "content", ["no json", "{}", '{"ranking": [3], "selected": []}', '{"ranking": [], "selected": [1]}']
)
def test_what_is_no_diagnosis_is_named(tmp_path, content):
    path = tmp_path / "d.json"
    path.write_text(content)
    with pytest.raises(InputError, match=r"d\.json.*diagnosis"):
        read_diagnosis(path)
    assert read_diagnosis(_written(tmp_path, diagnosis([("ghost", {})], ["unknown"])))["selected"] == ["unknown"]


def _written(folder, content):
    path = folder / "good.json"
    path.write_text(json.dumps(content))
    return path
