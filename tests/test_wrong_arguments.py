"""Wrong arguments of public functions end in InputError of one line, before any computation."""

from functools import cache
from pathlib import Path

import cboxlab
import numpy as np
import pytest
from cboxlab.utils.arguments import described, required_folder, required_number, required_path
from helpers.places import ROOT

CAPTURE = ROOT / "validate" / "data" / "demo-capture"
DATASET = ROOT / "tests" / "version_0_1" / "dataset"


class Odd:
    """An object whose text cannot be formed."""

    def __repr__(self):
        raise ZeroDivisionError


#: No paths and no texts.
OBJECTS = (3, -2.5, True, float("nan"), b"x", [], {}, object(), np.zeros((2, 3)), Odd())
NUMBERS = ("nan", "3", True, float("nan"), float("inf"), 1j, [1.0], np.ones(2), object(), -1e300)
PATHS = (None, *OBJECTS, "", "a\0b", "n" * 5000, "\ud800", Path("/dev/null/x"))
FOLDERS = (*OBJECTS, "", "a\0b", "n" * 5000, __file__, f"{__file__}/x")

scene, model = cboxlab.load_scene("cornell-box"), cboxlab.load_model("cornell-box")


@cache
def opened():
    return cboxlab.open_dataset(DATASET)


CASES = {
    "load_capture": (cboxlab.load_capture, PATHS),
    "load_scene": (cboxlab.load_scene, PATHS),
    "load_model": (cboxlab.load_model, PATHS),
    "open_dataset": (cboxlab.open_dataset, PATHS),
    "calibrate": (cboxlab.calibrate, PATHS),
    "validate": (cboxlab.validate, PATHS),
    "reference_uncertainty": (lambda w: cboxlab.calibrate(CAPTURE, reference_uncertainty=w), (None, -1, 2, *NUMBERS)),
    "validate noise": (lambda w: cboxlab.validate(CAPTURE, noise=w), (0, -1, *NUMBERS)),
    "validate seed": (lambda w: cboxlab.validate(CAPTURE, seed=w), (-1, 0.5, 2**63, *NUMBERS)),
    "validate model": (lambda w: cboxlab.validate(CAPTURE, model=w), (*OBJECTS, "cornel-box")),
    "validate cache": (lambda w: cboxlab.validate(CAPTURE, cache=w), FOLDERS),
    "validate declared": (lambda w: cboxlab.validate(CAPTURE, declared=w), OBJECTS),
    "validate progress": (lambda w: cboxlab.validate(CAPTURE, progress=w), OBJECTS),
    "diagnose progress": (lambda w: cboxlab.diagnose(CAPTURE, progress=w), OBJECTS),
    "Study.open cache": (lambda w: cboxlab.Study.open(CAPTURE, cache=w), FOLDERS),
    "Study.read": (cboxlab.Study.read, PATHS),
    "render wavelengths": (lambda w: cboxlab.render(wavelengths=w), ([], [500, 400], ["a"], {}, [np.nan], Odd())),
    "render size": (lambda w: cboxlab.render(size=w), (None, 0, -1, 2.5, 2**20, *NUMBERS)),
    "render camera": (lambda w: cboxlab.render(camera=w), OBJECTS),
    "render noise": (lambda w: cboxlab.render(noise=w), (None, 0, *NUMBERS)),
    "render percentile": (lambda w: cboxlab.render(percentile=w), (None, -1, 101, *NUMBERS)),
    "render samples": (lambda w: cboxlab.render(samples=w), (0, -1, 2.5, *NUMBERS)),
    "simulate": (cboxlab.simulate, PATHS),
    "simulate camera": (lambda w: cboxlab.simulate("x.nc", w), (None, *OBJECTS, "dcs2000")),
    "simulate f_number": (lambda w: cboxlab.simulate("x.nc", f_number=w), (0, *NUMBERS)),
    "assert_same_light": (lambda w: cboxlab.assert_same_light(w, w), (*OBJECTS, "n" * 5000, "nowhere.exr")),
    "false_alarms": (lambda w: cboxlab.assert_same_light("a.nc", "b.nc", false_alarms=w), (0, 0.9, *NUMBERS)),
    "create_dataset": (lambda w: cboxlab.create_dataset(w, "x"), PATHS),
    "Declared scale": (lambda w: cboxlab.Declared(scale=w), (0, -1, *NUMBERS)),
    "Declared units": (lambda w: cboxlab.Declared(units=w), OBJECTS),
    "ProgressReporter": (cboxlab.ProgressReporter, (None, *OBJECTS)),
    "with_reflectance": (lambda w: scene.with_reflectance("red", w, w), (None, *OBJECTS, [2, 1])),
    "with_material": (scene.with_material, (None, *OBJECTS, "red")),
    "with_lamp": (lambda w: scene.with_lamp([400, 500], w), (-1, "x", [1], [1, np.nan], Odd())),
    "moved": (lambda w: scene.moved("tall-block", w), (*OBJECTS, "x", [1, 2, np.inf])),
    "moved surface": (scene.moved, (None, *OBJECTS, "tall-blok")),
    "turned": (lambda w: scene.moved("tall-block", turn_deg=w), NUMBERS[:-1]),
    "surface": (scene.surface, (None, *OBJECTS, "cieling")),
    "scene.write": (scene.write, PATHS),
    "with_effect": (model.with_effect, (None, *OBJECTS, "veiling-glair", "none.toml")),
    "fraction": (lambda w: model.with_effect("veiling-glare", fraction=w), (None, *NUMBERS)),
    "dataset[]": (lambda w: opened()[w], (None, *OBJECTS[1:], 99)),
    "dataset.part": (lambda w: opened().part(w), (None, *OBJECTS, "tran")),
    "dataset.where": (lambda w: opened().where(**w), ({"cam": "main"}, {"camera": None}, {"camera": []})),
    "dataset.arrays": (lambda w: opened().arrays(w), (None, *OBJECTS, "radience")),
    "dataset.export": (lambda w: opened().export(w), (None, *FOLDERS)),
    "dataset.export ending": (lambda w: opened().export("x", w), (None, *OBJECTS, ".jpg")),
}


@pytest.mark.parametrize("name", CASES)
def test_wrong_arguments_are_input_errors_of_one_line(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    function, wrong = CASES[name]
    for argument in wrong:
        with pytest.raises(cboxlab.InputError) as fault:
            function(argument)
        assert "\n" not in str(fault.value), described(argument)
    assert not list(tmp_path.iterdir())


def test_sound_arguments_pass(tmp_path):
    assert required_number("x", np.float32(0.5), least=0, most=1) == 0.5
    assert required_path("x", "new") == Path("new")
    assert required_folder("x", tmp_path / "a" / "b") == tmp_path / "a" / "b"


def test_a_message_is_one_line_whatever_the_name():
    error = cboxlab.InputError("a\nb\x1b[31m", "\u202e", "text")
    assert str(error) == r"a\nb\x1b[31m: found \u202e; expected text"
