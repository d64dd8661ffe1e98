"""Files are complete or absent, whoever is killed or writes at the same time."""

import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.files import replacing, replacing_folder

ENDLESS = """
import sys, time
from pathlib import Path
from cboxlab.scenes.files import replacing, replacing_folder
with {writer}(Path(sys.argv[1])) as temporary:
    (temporary / "part" if temporary.is_dir() else temporary).write_text("half")
    print("writing", flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize("writer", ["replacing", "replacing_folder"])
def test_what_a_killed_process_leaves_is_removed_by_the_next(tmp_path, writer):
    path = tmp_path / "result.nc"
    program = [sys.executable, "-c", ENDLESS.format(writer=writer), str(path)]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "writing\n"
        assert not path.exists()
        with replacing(path) as temporary:  # another writer leaves a running one's file alone
            temporary.write_text("whole")
        assert len(list(tmp_path.iterdir())) == 2
        os.kill(process.pid, signal.SIGKILL)
    path.unlink()
    with globals()[writer](path) as temporary:
        (temporary / "part" if temporary.is_dir() else temporary).write_text("whole")
    assert [p.name for p in tmp_path.iterdir()] == ["result.nc"]


def test_many_writers_of_one_file_leave_one_whole_file(tmp_path):
    def write(number):
        with replacing(tmp_path / "a.txt") as temporary:
            temporary.write_text(str(number) * 1000)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(200)))
    (path,) = tmp_path.iterdir()
    text = path.read_text()
    assert text == text[: len(text) // 1000] * 1000


def test_a_failed_block_leaves_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError), replacing(tmp_path / "a.txt"):
        raise ZeroDivisionError
    with pytest.raises(ZeroDivisionError), replacing_folder(tmp_path / "a"):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_holds_something_is_kept(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "mine").write_text("x")
    with pytest.raises(InputError), replacing_folder(tmp_path / "a"):
        pass
    assert (tmp_path / "a" / "mine").read_text() == "x"
