"""Causes of other packages that misbehave: one message that names the entry point or the file."""

import sys
from dataclasses import replace
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.utils import other_packages
from cboxlab.utils.errors import InputError
from cboxlab.validation.compare_renders.regress.causes import Cause, Pictures, Trial, causes

BASELINE = np.arange(1.0, 25.0).reshape(2, 4, 3)
PICTURES = Pictures(
    BASELINE,
    1.1 * BASELINE,
    (BASELINE[None], 1.1 * BASELINE[None]),
    np.array([450.0, 550, 650]),
    BASELINE[..., 0],
    None,
    None,
    None,
    None,
)


@pytest.fixture
def plugged(monkeypatch):
    """Installs a cause as the only one of another package and gives it as the catalogue has it."""

    def plug(cause):
        monkeypatch.setitem(sys.modules, "odd", SimpleNamespace(CAUSE=cause))
        entry = EntryPoint("odd", "odd:CAUSE", "cboxlab.regress_causes")
        monkeypatch.setattr(other_packages, "entry_points", lambda group: [entry])
        causes.cache_clear()
        return next(cause for cause in causes() if cause.id == "odd")

    yield plug
    causes.cache_clear()


def cause(*trials, **fields):
    return replace(Cause("odd", "An odd thing.", lambda pictures: iter(trials)), **fields)


TRIAL = Trial(lambda amplitudes: {"part": float(amplitudes[0])}, (BASELINE,))

#: What the function of a cause does, and words of the message.
TRIALS = {
    "raises": (lambda pictures: 1 / 0, "ZeroDivisionError"),
    "ends the program": (lambda pictures: sys.exit(3), "exit code 3"),
    "ends the program while it yields": (lambda pictures: (sys.exit(4) for _ in range(1)), "exit code 4"),
    "gives nothing": (lambda pictures: None, "TypeError"),
    "gives numbers": (lambda pictures: [1.0], "a float"),
    "gives another shape": (lambda pictures: [replace(TRIAL, templates=(BASELINE[0],))], "shape (4, 3)"),
    "gives what is not finite": (lambda pictures: [replace(TRIAL, templates=(BASELINE * np.nan,))], "not finite"),
    "subtracts what is not finite": (lambda pictures: [replace(TRIAL, fixed=BASELINE * np.inf)], "not finite"),
    "has templates of text": (lambda pictures: [replace(TRIAL, templates="ab")], "shape ()"),
    "has no templates": (lambda pictures: [replace(TRIAL, templates=None)], "TypeError"),
    "counts backwards": (lambda pictures: [replace(TRIAL, selected=-2)], "selected = -2"),
    "cannot be asked": (lambda pictures: [replace(TRIAL, parameters={})], "no function"),
}

#: What the parameters of a trial are, and words of the message.
PARAMETERS = {
    "raise": (lambda a: a[7], "IndexError"),
    "end the program": (lambda a: sys.exit(), "end the program"),
    "are a number": (lambda a: 1.0, "a float"),
    "are not finite": (lambda a: {"part": float("nan")}, "part = nan"),
    "are arrays": (lambda a: {"part": a}, "part = array"),
    "have numbers for names": (lambda a: {1: 2.0}, "named 1"),
}


def assert_named(refusal, phrase):
    message = str(refusal.value)
    assert "entry point cboxlab.regress_causes: odd = odd:CAUSE" in message
    assert phrase in message and "\n" not in message


@pytest.mark.parametrize("way", TRIALS)
def test_trials_that_misbehave_are_named_in_one_line(plugged, way):
    function, phrase = TRIALS[way]
    odd = plugged(cause(trials=function))
    with pytest.raises(InputError) as refusal:
        list(odd.trials(PICTURES))
    assert_named(refusal, phrase)


@pytest.mark.parametrize("way", PARAMETERS)
def test_parameters_that_misbehave_are_named_in_one_line(plugged, way):
    function, phrase = PARAMETERS[way]
    (trial,) = plugged(cause(replace(TRIAL, parameters=function))).trials(PICTURES)
    with pytest.raises(InputError) as refusal:
        trial.parameters(np.array([0.1]))
    assert_named(refusal, phrase)


def test_sound_trials_pass_unchanged(plugged):
    trials = list(plugged(cause(TRIAL, replace(TRIAL, parameters=lambda a: None))).trials(PICTURES))
    assert trials[0].templates[0] is BASELINE
    assert [trial.parameters(np.array([0.1])) for trial in trials] == [{"part": 0.1}, None]


@pytest.mark.parametrize("fields", [{"id": 7}, {"summary": None}, {"trials": 1}, {"shape_error": float("nan")}])
def test_a_record_with_a_wrong_field_is_refused(plugged, fields):
    with pytest.raises(InputError, match=f"odd = odd:CAUSE.*wrong {next(iter(fields))}"):
        plugged(cause(**fields))
