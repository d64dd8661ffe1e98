"""The public face: cheap to import, its names plain functions and classes of the rooms."""

import inspect
import pickle
import rlcompleter
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import cboxlab
import pytest
from helpers.places import ROOT

NAMES = (
    "load_capture",
    "calibrate",
    "validate",
    "diagnose",
    "render",
    "simulate",
    "load_scene",
    "load_model",
)


def run(code, folder):
    """Standard output of a program in a separate process and folder."""
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_importing_it_loads_nothing_else():
    code = "import sys, cboxlab; print(*({name.split('.')[0] for name in sys.modules} & {'numpy', 'mitsuba', 'drjit'}))"
    assert run(code, ROOT) == []


def test_every_name_is_there_and_said():
    assert set(NAMES) | {"__version__"} <= set(cboxlab.__all__) <= set(dir(cboxlab))
    assert all(callable(getattr(cboxlab, name)) for name in NAMES)
    assert cboxlab.__version__.count(".") == 2
    with pytest.raises(AttributeError, match="no attribute 'vallidate'"):
        cboxlab.vallidate  # noqa: B018


@pytest.mark.parametrize("name", ["validate", "render", "calibrate", "diagnose", "simulate"])
def test_a_public_function_is_a_plain_function(name):
    function = getattr(cboxlab, name)
    assert inspect.isfunction(function) and inspect.getdoc(function)
    first = next(iter(inspect.signature(function).parameters))
    assert first in {"capture", "captures", "model", "cube"}
    assert pickle.loads(pickle.dumps(function)) is function


def test_a_public_function_runs_in_another_process():
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        error = pool.submit(cboxlab.validate, "nowhere").exception()
    assert isinstance(error, cboxlab.InputError) and "nowhere" in error.where


def test_a_shell_completes_the_public_names():
    completions = rlcompleter.Completer({"cboxlab": cboxlab})
    assert "cboxlab.validate" in (completions.complete("cboxlab.vali", 0) or "")


def test_the_rooms_are_found_in_a_checkout(tmp_path):
    """From the checkout's folder, where ``cboxlab`` is a plain folder next to the rooms, and from elsewhere."""
    code = "import cboxlab.scenes as scenes, os; print(os.path.realpath(scenes.__file__))"
    text = str(ROOT / "scenes" / "__init__.py")
    assert run(code, ROOT) == [text]
    assert run(code, tmp_path) == [text]
