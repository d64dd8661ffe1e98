"""Files are complete or absent, whoever is killed or writes at the same time."""

import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import load_checked, replacing, replacing_folder, store_checked, temporary_folder

ENDLESS = """
import sys, time
from pathlib import Path
from cboxlab.utils.files import replacing, replacing_folder, temporary_folder
with {writer} as temporary:
    (temporary / "part" if temporary.is_dir() else temporary).write_text("half")
    print("writing", flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize("writer", ["replacing", "replacing_folder"])
def test_what_a_killed_process_leaves_is_removed_by_the_next(tmp_path, writer):
    path = tmp_path / "result.nc"
    program = [sys.executable, "-c", ENDLESS.format(writer=f"{writer}(Path(sys.argv[1]))"), str(path)]
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


def test_a_killed_process_leaves_no_temporary_folder_for_long(tmp_path, monkeypatch):
    """It stays until another process makes one; that of a running process stays until it ends."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    program = [sys.executable, "-c", ENDLESS.format(writer="temporary_folder()")]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        process.stdout.readline()
        with temporary_folder() as folder:
            assert len([*tmp_path.iterdir()]) == 2 and folder.is_dir()
        process.send_signal(signal.SIGKILL)
    assert len([*tmp_path.iterdir()]) == 1
    with temporary_folder() as folder:
        assert [*tmp_path.iterdir()] == [folder]
    assert not [*tmp_path.iterdir()]


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


def test_of_two_writers_of_one_folder_the_second_is_refused(tmp_path):
    """Both begin while the folder is absent; the first to end has it, whole."""
    with pytest.raises(InputError, match="exists already"), replacing_folder(tmp_path / "a") as late:
        (late / "part").write_text("late")
        with replacing_folder(tmp_path / "a") as first:
            (first / "part").write_text("first")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a" / "part").read_text() == "first"


def test_what_is_kept_comes_back_only_whole_and_for_its_key(tmp_path):
    """A thousand flipped bits and a thousand truncations are all noticed."""
    path, random = tmp_path / "entry", np.random.default_rng(3)
    store_checked(path, "made from this", random.bytes(5000))
    sound = path.read_bytes()
    assert load_checked(path, "made from this") == sound[32:] and len(sound) == 5032
    assert load_checked(path, "made from that") is None and load_checked(tmp_path / "absent", "made from this") is None
    for position, length in zip(
        random.integers(0, 8 * len(sound), 1000), random.integers(0, len(sound), 1000), strict=True
    ):
        flipped = bytearray(sound)
        flipped[position // 8] ^= 1 << (position % 8)
        for damaged in (bytes(flipped), sound[:length]):
            path.write_bytes(damaged)
            assert load_checked(path, "made from this") is None
    path.unlink()
    os.mkfifo(path)  # whose content would never come
    assert load_checked(path, "made from this") is None


FULL_DISK = """
import resource, signal, sys
from pathlib import Path
import numpy as np, xarray as xr
from cboxlab.utils.files import writing_hdf5
cube = xr.Dataset({"radiance": (("y", "x"), np.random.default_rng(1).random((100, 100)))})
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
with writing_hdf5(Path(sys.argv[1])) as file:
    cube.to_netcdf(file, engine="h5netcdf")
for most in (0, 100, 3000, 40_000, 80_000):
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))
    try:
        with writing_hdf5(Path(sys.argv[2])) as file:
            cube.to_netcdf(file, engine="h5netcdf")
    except OSError as fault:
        assert fault.filename == sys.argv[2]
        print(most, flush=True)
assert xr.load_dataset(sys.argv[1]).identical(cube)
"""


def test_a_full_disk_is_an_error_and_no_crash_of_the_hdf5_library(tmp_path):
    complete, part = tmp_path / "whole.nc", tmp_path / "part.nc"
    program = [sys.executable, "-c", FULL_DISK, str(complete), str(part)]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()) == (0, ["0", "100", "3000", "40000", "80000"]), done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["whole.nc"]
