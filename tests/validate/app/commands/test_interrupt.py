"""Ctrl-C in the terminal: it stops a computation at its next step, and at once when pressed again."""

import contextlib
import os
import signal
import subprocess
import sys

import pytest
from cboxlab.utils.progress import Cancelled
from cboxlab.validation.app.commands import cli, console
from cboxlab.validation.app.terminal import stages


@pytest.fixture(autouse=True)
def in_the_foreground():
    """Shells start background jobs with Ctrl-C ignored; a command in the terminal has Python's own handler."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_in_the_terminal_cancels_and_the_second_interrupts(capsys):
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(Cancelled), console.bar("working") as progress:
        progress.part(0.1)
        signal.raise_signal(signal.SIGINT)
        progress.part(0.2)
    with pytest.raises(KeyboardInterrupt), console.bar("working"):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
    assert capsys.readouterr().err.count("Stopping") == 2


def test_a_stopped_command_says_so_and_leaves_nothing(tmp_path, monkeypatch, capsys):
    """As if Ctrl-C was pressed while the first pass is rendered."""
    update = stages.ProgressBar.update

    def pressed(*arguments, **keywords):
        update(*arguments, **keywords)
        if keywords["completed"] > 0.1:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(stages.ProgressBar, "update", pressed)
    cube = ("--size", "16", "--wavelengths", "500,600", "--noise", "0.5%")
    with pytest.raises(SystemExit) as caught:
        cli.main(["render", "cornell-box", "--out", str(tmp_path / "cube.nc"), *cube])
    assert caught.value.code == 130
    assert "Stopped" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] in ([], ["cube.nc.passes"])


PRESSED_IN_IMPORT = """
import signal, sys
from cboxlab.rendering.device import variant
signal.signal(signal.SIGINT, signal.default_int_handler)
class Pressing:
    def find_spec(self, name, path, target=None):
        if name == "drjit._drjit_ext":
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt as pressed:  # as the extension's own start makes of it
                raise ImportError from pressed
sys.meta_path.insert(0, Pressing())
try:
    variant.ensure()
except KeyboardInterrupt:
    del sys.meta_path[0]
    print("interrupted", variant.compiled())
"""


def test_ctrl_c_while_the_renderer_is_imported_interrupts_afterwards():
    program = [sys.executable, "-c", PRESSED_IN_IMPORT]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert done.stdout == "interrupted True\n", done.stderr


def test_a_command_goes_on_when_the_reader_of_its_output_has_gone(tmp_path):
    """As before ``| head``: its result is written, and its exit code is its own."""
    program = [sys.executable, "-c", "from cboxlab.validation.app.commands.cli import main; main()"]
    arguments = ["effects", "--json", str(tmp_path / "effects.json")]
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([*program, *arguments], stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "effects.json").stat().st_size > 100


def test_an_error_that_ctrl_c_became_is_no_fault_of_the_program(monkeypatch, capsys):
    """SciPy's modules end in a NameError where it is pressed while they are imported."""

    def importing(**_):
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise NameError("name '_ndimage_api' is not defined")

    monkeypatch.setattr("cboxlab.validation.app.commands.app.app", importing)
    with pytest.raises(SystemExit) as ended:
        cli.main(["effects"])
    assert ended.value.code == 130
    assert capsys.readouterr().err == "interrupted\n"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


PRESSED_AT_THE_START = """
import importlib.abc, signal, sys
class Pressing(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "scipy.ndimage._morphology":
            signal.raise_signal(signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Pressing())
from cboxlab.validation.app.commands.cli import main
main(["effects"])
"""


def test_ctrl_c_while_the_program_is_imported_ends_it():
    """trimesh catches it there; the command ran on, or met a half imported SciPy."""
    program = [sys.executable, "-c", PRESSED_AT_THE_START]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")
