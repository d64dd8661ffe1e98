"""Examples in the docstrings of the public interface run, and print what they state."""

import doctest
from importlib import import_module

import numpy as np
import pytest

#: Modules whose docstrings have examples.
MODULES = (
    "cboxlab.utils.errors",
    "cboxlab.scenes.camera",
    "cboxlab.scenes.scene",
    "cboxlab.scenes.scene_file",
    "cboxlab.scenes.spectra",
    "cboxlab.rendering.effects",
    "cboxlab.rendering.effects.effect",
    "cboxlab.rendering.model.model_file",
)


@pytest.mark.parametrize("name", MODULES)
def test_examples_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with np.printoptions(legacy=False):  # colour-science sets NumPy's old style of printing
        outcome = doctest.testmod(import_module(name))
    assert outcome.attempted > 0
    assert outcome.failed == 0
