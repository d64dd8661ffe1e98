"""Ctrl-C in the terminal: it stops a computation at its next step, and at once when pressed again."""

import signal

import pytest
from cboxlab.scenes.progress import Cancelled
from cboxlab.validate.commands import cli, console
from cboxlab.validate.terminal import stages


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
    assert capsys.readouterr().err.count("stopping") == 2


def test_a_stopped_command_says_so_and_leaves_nothing(tmp_path, monkeypatch, capsys):
    """As if Ctrl-C was pressed while the first pass is rendered."""
    shown = stages.ProgressBar.update

    def pressed(*arguments, **keywords):
        shown(*arguments, **keywords)
        if keywords["completed"] > 0.1:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(stages.ProgressBar, "update", pressed)
    cube = ("--size", "16", "--wavelengths", "500,600", "--noise", "0.5%")
    with pytest.raises(SystemExit) as caught:
        cli.main(["render", "cornell-box", "--out", str(tmp_path / "cube.nc"), *cube])
    assert caught.value.code == 130
    assert "stopped" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] in ([], ["cube.nc.passes"])
