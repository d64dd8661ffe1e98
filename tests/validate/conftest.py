"""Commands of ``cbox`` in this process."""

import pytest
from cboxlab.validation.app.commands.cli import main


@pytest.fixture
def cbox(capsys):
    """Run a command in this process: (exit code, standard output, standard error)."""

    def run(*arguments):
        with pytest.raises(SystemExit) as caught:
            main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return caught.value.code or 0, captured.out, captured.err

    return run
