"""Families of other packages that misbehave: one message that names the entry point."""

import sys
from dataclasses import replace
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.utils import other_packages
from cboxlab.utils.errors import InputError
from cboxlab.validation.diagnose.explain import explain, explain_masked_families
from cboxlab.validation.diagnose.families import families
from cboxlab.validation.diagnose.field_fit import Family, MaskedPattern
from helpers.captures.small_excess import COLUMNS, SIGNAL, small_excess


@pytest.fixture
def plugged(monkeypatch):
    """Installs a family as the only one of another package."""

    def plug(family):
        monkeypatch.setitem(sys.modules, "odd", SimpleNamespace(FAMILY=family))
        entry = EntryPoint("odd", "odd:FAMILY", "cboxlab.families")
        monkeypatch.setattr(other_packages, "entry_points", lambda group: [entry])
        families.cache_clear()

    yield plug
    families.cache_clear()


def sound_forms(fit_input):
    """Forms of a family that exists."""
    yield from families()["lamp-spectrum"].generate(fit_input)


def changed_forms(**fields):
    return lambda fit_input: (replace(form, **fields) for form in sound_forms(fit_input))


def of_coefficients(change):
    """Forms whose coefficients are changed."""
    for_fit = lambda fit: replace(fit, coefficients=change(fit.coefficients))  # noqa: E731
    return lambda fit_input: (replace(form, fit=for_fit(form.fit)) for form in sound_forms(fit_input))


def raising(error):
    def generate(fit_input):
        yield from ()
        raise error

    return generate


def leaving(fit_input):
    sys.exit(3)


#: What a generator does, and words of the message.
FORMS = {
    "raises": (raising(ZeroDivisionError("no")), "ZeroDivisionError: no"),
    "raises what is no Exception": (raising(GeneratorExit()), "GeneratorExit"),
    "ends the program": (leaving, "an attempt to end the program (exit code 3)"),
    "ends the program later": (raising(SystemExit(4)), "exit code 4"),
    "gives nothing": (lambda fit_input: None, "TypeError"),
    "gives numbers": (lambda fit_input: [1.0], "a float"),
    "gives what is not finite": (of_coefficients(lambda c: c * np.nan), "not finite"),
    "gives another shape": (of_coefficients(lambda c: c[:, :1].repeat(2, axis=1)), "ValueError"),
    "names a form by a number": (changed_forms(form=7), "a form named 7"),
    "has columns that fail": (changed_forms(columns=lambda band: [][1]), "IndexError"),
    "has columns of no number": (
        changed_forms(columns=lambda band: np.full((1, SIGNAL[0].size), np.nan)),
        "not finite",
    ),
    "has maps of text": (changed_forms(maps="rows"), "maps of type str"),
}


@pytest.fixture(scope="module")
def excess():
    return small_excess(0.02 * SIGNAL * np.cos(COLUMNS / 7))


@pytest.fixture
def alone(monkeypatch):
    """The competition of the family of the other package against one of cboxlab."""
    from cboxlab.validation.diagnose.explain import competition

    def some():
        members = families()
        return {name: members[name] for name in ("lamp-spectrum", "odd")}

    monkeypatch.setattr(competition, "families", some)


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize("acts_on", ["scene", "sensor"])
@pytest.mark.parametrize("way", FORMS)
def test_a_generator_that_misbehaves_is_named_in_one_line(plugged, excess, way, acts_on):
    generate, phrase = FORMS[way]
    plugged(Family("odd", "an odd thing", acts_on, generate))
    with np.errstate(all="ignore"), pytest.raises(InputError) as refusal:
        explain(excess)
    message = str(refusal.value)
    assert "entry point cboxlab.families: odd = odd:FAMILY" in message
    assert phrase in message and "\n" not in message


@pytest.mark.usefixtures("alone")
def test_masked_patterns_and_prior_odds_that_misbehave_are_named(plugged, excess):
    plugged(Family("odd", "an odd thing", "scene", sound_forms, masked=(MaskedPattern(1, leaving),)))
    with pytest.raises(InputError, match=r"odd = odd:FAMILY.*end the program"):
        explain_masked_families(excess)
    plugged(Family("odd", "an odd thing", "scene", sound_forms, spot_log_odds=lambda spot: float("nan")))
    with pytest.raises(InputError, match=r"odd = odd:FAMILY.*prior odds of nan"):
        families()["odd"].spot_log_odds(None)


@pytest.mark.usefixtures("alone")
def test_a_form_belongs_to_the_family_that_made_it(plugged, excess):
    """Forms bear the record of the catalogue, so that what is called later is watched, too."""
    plugged(Family("odd", "an odd thing", "scene", sound_forms))
    assert {rival.family for rival in explain(excess).rivals} >= {"lamp-spectrum", "odd"}


@pytest.mark.parametrize(
    "fields",
    [{"id": "No"}, {"id": 7}, {"title": None}, {"acts_on": "air"}, {"generate": 1}, {"order": "1"}, {"masked": [1]}],
)
def test_a_record_with_a_wrong_field_is_refused(plugged, fields):
    record = {"id": "odd", "title": "an odd thing", "acts_on": "scene", "generate": sound_forms}
    plugged(Family(**{**record, **fields}))
    with pytest.raises(InputError, match=f"odd = odd:FAMILY.*wrong {next(iter(fields))}"):
        families()
