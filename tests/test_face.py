"""The public face: cheap to import, its names the rooms' own, a room and a function under one name."""

import subprocess
import sys

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
    """Standard output of a program in a process and a folder of its own."""
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


CALLED = """
try:
    cboxlab.validate("nowhere")
except cboxlab.InputError:
    print("called")
from cboxlab.validate.commands import console
import cboxlab.render.chain as chain
print(cboxlab.validate.commands.console is console, cboxlab.render.chain is chain, callable(cboxlab.render))
"""


@pytest.mark.parametrize("first", ["", "from cboxlab.render.chain import RenderSettings"])
def test_a_room_and_a_function_have_one_name_whichever_comes_first(first, tmp_path):
    assert run(f"{first}\nimport cboxlab{CALLED}", tmp_path) == ["called", "True", "True", "True"]


def test_the_rooms_are_found_in_a_checkout(tmp_path):
    """From the checkout's folder, where ``cboxlab`` is a plain folder beside the rooms, and from elsewhere."""
    code = "import cboxlab.scenes as scenes, os; print(os.path.realpath(scenes.__file__))"
    own = str(ROOT / "scenes" / "__init__.py")
    assert run(code, ROOT) == [own]
    assert run(code, tmp_path) == [own]
