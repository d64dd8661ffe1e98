"""What is installed is whole: wheel and source archive hold all modules and data, though packages are a list."""

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from architecture import INSTALLED
from helpers.places import ROOT

#: Folders of the repository that are installed.
FOLDERS = ("cboxlab", "scenes", "calibration", "render", "validate")


def _build(kind: str, source: Path, folder: Path) -> None:
    """Builds a wheel or a source archive, without a network."""
    program = f"from setuptools import build_meta; build_meta.build_{kind}({str(folder)!r})"
    subprocess.run([sys.executable, "-c", program], cwd=source, check=True, capture_output=True)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """A wheel built from the source archive of a copy of the sources."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    for room in FOLDERS:
        shutil.copytree(ROOT / room, source / room, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy2(ROOT / name, source / name)
    _build("sdist", source, folder)
    (archive,) = folder.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        file.extractall(folder, filter="data")
    _build("wheel", folder / archive.name.removesuffix(".tar.gz"), folder)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel) -> set[str]:
    """Paths in the wheel."""
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


def test_what_the_wheel_holds_runs(wheel, tmp_path):
    """Its packages alone, unpacked as an installer does: the program, a packaged scene and the page's files."""
    with zipfile.ZipFile(wheel) as file:
        file.extractall(tmp_path)
    program = (
        "import sys, cboxlab, cboxlab.validation as room; from importlib.resources import files\n"
        f"assert cboxlab.__file__.startswith({str(tmp_path)!r}) and room.__path__[0].startswith({str(tmp_path)!r})\n"
        "assert len(cboxlab.load_scene('cornell-box').surfaces) > 5\n"
        "assert (files('cboxlab.validation') / 'data' / 'demo-capture' / 'capture.toml').is_file()\n"
        "from cboxlab.validation.app.commands.cli import main; main(['effects', 'ghost'])"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    ended = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert "ghost" in ended.stdout
