"""What the library logs, and what a command prints of it."""

import logging
import subprocess
import sys

import pytest
from cboxlab.rendering.device import variant
from cboxlab.utils.files import load_checked, store_checked
from cboxlab.validation.app.terminal import this_run


@pytest.fixture
def quiet_log():
    """Logger of the library, put back afterwards."""
    logger = logging.getLogger("cboxlab")
    level, handlers = logger.level, [*logger.handlers]
    yield logger
    logger.setLevel(level)
    logger.handlers[:] = handlers
    this_run.begin([])


def test_only_verbose_commands_print_the_log(quiet_log, capsys):
    this_run.begin(["validate"])
    module = logging.getLogger("cboxlab.validation.compare")
    module.info("a fit moves the picture by %.1f px", 0.1)
    assert capsys.readouterr().err == ""
    this_run.be_verbose()
    module.info("a fit moves the picture by %.1f px", 0.2)
    this_run.be_verbose()
    assert capsys.readouterr().err == "validation.compare: a fit moves the picture by 0.2 px\n"
    this_run.begin(["validate"])
    module.info("a fit moves the picture by %.1f px", 0.3)
    assert capsys.readouterr().err == ""


def test_silent_decisions_are_logged(tmp_path, caplog):
    """A damaged entry of a cache, and the device that is used in place of another."""
    path = tmp_path / "entry"
    store_checked(path, "key", b"content")
    with caplog.at_level(logging.INFO, logger="cboxlab"):
        assert load_checked(path, "key") == b"content" and not caplog.records
        assert load_checked(path, "other key") is None
        assert load_checked(tmp_path / "absent", "key") is None
        variant.use("cpu")
    assert [record.name for record in caplog.records] == ["cboxlab.utils.files", "cboxlab.rendering.device.variant"]
    assert str(path) in caplog.text


def test_a_program_that_sets_up_no_log_prints_none():
    command = "import cboxlab, logging; logging.getLogger('cboxlab.rendering').warning('unseen')"
    run = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
    assert run.stderr == ""
