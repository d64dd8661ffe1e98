"""What is installed is whole: the wheel holds every module and data file, though packages are listed by hand."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from architecture import INSTALLED
from helpers.places import ROOT

#: Folders of the repository that are installed.
FOLDERS = ("cboxlab", "scenes", "calibration", "render", "validate")


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> set[str]:
    """Paths in a wheel built from a copy of the sources, without a network."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    for room in FOLDERS:
        shutil.copytree(ROOT / room, source / room, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy2(ROOT / name, source / name)
    program = f"from setuptools import build_meta; build_meta.build_wheel({str(folder)!r})"
    subprocess.run([sys.executable, "-c", program], cwd=source, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    return set(zipfile.ZipFile(wheel).namelist())


def installed_as(path: Path) -> str:
    """Where a file of the repository lies in an installation."""
    inside = path.relative_to(ROOT)
    if inside.parts[0] == "cboxlab":
        return str(inside)
    room, *others = inside.parts
    return str(Path("cboxlab", INSTALLED.get(room, room), *others))


def test_every_file_of_the_rooms_is_in_the_wheel(installed):
    files = [
        path
        for room in FOLDERS
        for path in (ROOT / room).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".pyc"
    ]
    assert len(files) > 200
    assert sorted(installed_as(path) for path in files if installed_as(path) not in installed) == []
