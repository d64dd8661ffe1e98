"""Packages of effects that misbehave: one message that names the entry point, and nothing else is harmed."""

import importlib
import os
import sys
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from cboxlab.rendering.chain import Light
from cboxlab.rendering.effects import apply_checked, catalogue
from cboxlab.scenes.camera import Camera
from cboxlab.utils import other_packages
from cboxlab.utils.errors import InputError

HEAD = """
import os, sys, time
import numpy as np
from cboxlab.rendering.effects import Effect, Parameter

def effect(apply, **fields):
    whole = {"id": "dust", "stage": "optics", "summary": "dust", "confirm": "clean it", "apply": apply,
             "parameters": (Parameter("fraction", null=0.0, low=0.0, high=1.0),)}
    return Effect(**{**whole, **fields})

def dimmed(light, fraction):
    return light.with_signal((1 - fraction) * light.signal)
"""

#: What a package does when it is imported, and words of the message.
IMPORTS = {
    "exits": ("sys.exit(3)", "an attempt to end the program (exit code 3)"),
    "raises what is no Exception": ("class Own(BaseException): pass\nraise Own('no')", "Own: no"),
    "raises lines": ("raise ValueError('a\\nb')", "ValueError: a b"),
    "has no such name": ("", "AttributeError"),
    "is no effect": ("EFFECT = effect", "a function"),
    "bears a number": ("EFFECT = effect(dimmed, id=7)", "a wrong id"),
    "acts nowhere": ("EFFECT = effect(dimmed, stage='light')", "a wrong stage"),
    "lists its parameters": ("EFFECT = effect(dimmed, parameters=[])", "wrong parameters"),
    "cannot be called": ("EFFECT = effect(None)", "a wrong apply"),
    "contradicts itself": ("EFFECT = effect(dimmed, title=60 * 'x')", "at most 50"),
    "is there already": ("EFFECT = effect(dimmed, id='ghost')", "'ghost'"),
}

#: What the function of an effect does, and words of the message.
CALLS = {
    "exits": ("sys.exit()", "an attempt to end the program"),
    "raises": ("1 / 0", "ZeroDivisionError"),
    "raises what is no Exception": ("raise GeneratorExit", "GeneratorExit"),
    "returns nothing": ("pass", "a NoneType"),
    "returns an array": ("return light.signal", "a ndarray"),
    "returns another shape": ("return light.with_signal(light.signal[:, :2])", "signal of shape (2, 2, 4)"),
    "returns what is not finite": ("return light.with_signal(light.signal / 0)", "not finite"),
    "changes its input": ("light.signal[0] = 0\n    return light", "signal changed in place"),
}


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Installs a package with the given text; its only effect is then in the catalogue, or refused."""

    def install(text):
        (tmp_path / "misbehaving.py").write_text(HEAD + text + "\n")
        importlib.invalidate_caches()
        entry = EntryPoint("dust", "misbehaving:EFFECT", "cboxlab.effects")
        monkeypatch.setattr(other_packages, "entry_points", lambda group: [entry])
        catalogue.cache_clear()
        return catalogue()

    monkeypatch.syspath_prepend(tmp_path)
    yield install
    sys.modules.pop("misbehaving", None)
    catalogue.cache_clear()


def light():
    signal = np.arange(24.0).reshape(2, 3, 4) + 1
    camera = Camera(4, 3, 4.0, np.array([1.5, 1.0]), 0.0, np.eye(3), np.zeros(3))
    return Light(signal, np.array([450.0, 550.0]), camera)


def dusty():
    return apply_checked("dust", {"fraction": 0.1}, "model")


@pytest.mark.parametrize("way", IMPORTS)
def test_at_import(package, way):
    text, phrase = IMPORTS[way]
    with pytest.raises(InputError) as refusal:
        package(text)
    message = str(refusal.value)
    assert "entry point cboxlab.effects: dust = misbehaving:EFFECT" in message
    assert phrase in message and "\n" not in message


@pytest.mark.parametrize("way", CALLS)
def test_when_it_acts(package, way):
    body, phrase = CALLS[way]
    package(f"def broken(light, fraction):\n    {body}\nEFFECT = effect(broken)")
    with np.errstate(all="ignore"), pytest.raises(InputError) as refusal:
        dusty().apply(light())
    assert "dust = misbehaving:EFFECT" in str(refusal.value) and phrase in str(refusal.value)


def test_what_it_prints_and_where_it_goes(package, capsys, tmp_path, monkeypatch):
    """Standard output holds results alone; the working directory is that of the command."""
    monkeypatch.chdir(tmp_path)
    package(
        "print('hello'); os.chdir('/')\n"
        "def loud(light, fraction):\n    print('again'); os.chdir('/')\n    return dimmed(light, fraction)\n"
        "EFFECT = effect(loud)"
    )
    changed = dusty().apply(light())
    assert np.allclose(changed.signal, 0.9 * light().signal)
    assert os.getcwd() == str(tmp_path)
    assert capsys.readouterr() == ("", "hello\nagain\n")


def test_what_is_imported_slowly_is_named(package, monkeypatch):
    monkeypatch.setattr(other_packages, "_LONGEST_IMPORT_S", 0.01)
    with pytest.warns(RuntimeWarning, match="dust = misbehaving:EFFECT: its import took"):
        package("time.sleep(0.05)\nEFFECT = effect(dimmed)")


def test_ctrl_c_in_an_effect_is_no_fault_of_it(package):
    package("def broken(light, fraction):\n    raise KeyboardInterrupt\nEFFECT = effect(broken)")
    with pytest.raises(KeyboardInterrupt):
        dusty().apply(light())
