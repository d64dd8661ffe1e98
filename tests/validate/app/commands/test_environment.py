"""Where a command runs: locales without our signs, folders in other scripts, no home, no cache, no display."""

import json
import os
import subprocess
import sys
from pathlib import Path

from cboxlab.rendering.files import read_cube, write_cube
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE

#: An ASCII terminal, with nowhere to keep anything and a display that is not there.
BARE = {
    "LC_ALL": "C",
    "PYTHONUTF8": "0",
    "PYTHONCOERCECLOCALE": "0",
    "HOME": "/dev/null/home",
    "TMPDIR": "/dev/null/tmp",
    "XDG_CACHE_HOME": "/dev/null/cache",
    "MPLBACKEND": "TkAgg",
    "PATH": os.environ["PATH"],
    "OPENBLAS_NUM_THREADS": "1",
}


def cbox(folder: Path, *arguments: str, **more: str) -> subprocess.CompletedProcess:
    program = [str(Path(sys.executable).with_name("cbox")), *arguments]
    return subprocess.run(program, cwd=folder, env={**BARE, **more}, capture_output=True, check=False)


def test_a_capture_is_calibrated_in_a_bare_environment(tmp_path):
    """The signs that ASCII lacks are spelled out; JSON and pages keep them."""
    folder = tmp_path / "Мера и свет 光 ñ"
    folder.mkdir()
    (folder / "capture 1").symlink_to(DEMO_CAPTURE)
    result = cbox(folder, "calibrate", "capture 1", "--out", "out 1", "--json", "-")
    assert result.returncode == 0 and b"Traceback" not in result.stderr, result.stderr
    assert b"CIEDE2000" in result.stderr and b"?" not in result.stderr and b"atplotlib" not in result.stderr
    content = json.loads(result.stdout.decode("ascii"))
    stored = json.loads((folder / "out 1" / "calibration.json").read_text(encoding="utf-8"))
    assert content["suspicions"] == stored["suspicions"] == []


def test_names_that_the_locale_cannot_read_are_refused(tmp_path):
    result = cbox(tmp_path, "render", "cornell-box", "--out", "куб.exr")
    assert result.returncode == 2
    message = result.stderr.decode("ascii").splitlines()[-1]
    assert message.startswith("error: ????") and "encoding, ascii" in message and "LC_ALL=C.UTF-8" in message


def test_other_scripts_in_names_and_results(tmp_path):
    """As on any machine of today, whose encoding is UTF-8 and whose home has the kernels of earlier runs."""
    where = tmp_path / "снимки 光"
    (where / "куб").mkdir(parents=True)
    options = ("--size", "8", "--noise", "20%", "--wavelengths", "500,600")
    exr, netcdf = "куб/é ñ.exr", "куб/é ñ.nc"
    today = {"LC_ALL": "C.UTF-8", "PYTHONUTF8": "1", "HOME": str(Path.home())}
    result = cbox(where, "render", "cornell-box", "--out", exr, *options, **today)
    assert result.returncode == 0, result.stderr
    assert exr in result.stdout.decode()
    cube = read_cube(where / exr)
    assert cube["radiance"].shape == (8, 8, 2)
    write_cube(where / netcdf, cube)  # as the command writes it
    assert read_cube(where / netcdf)["radiance"].equals(cube["radiance"])
