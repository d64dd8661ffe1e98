"""Pytest plugin: the fixture ``same_light`` compares renderings with references next to the test.

    def test_box(same_light):
        same_light("box", "box.nc", seed=2, samples=512, versions={"ourrenderer": "3.2"})

compares means over surfaces, bands and blocks, and patterns, with ``references/box.json``. A single picture is compared
with a copy of the earlier one, ``references/box.exr``, as by ``cbox regress``, where it states no errors or larger ones
than a reference may have. A missing reference is an error. Only ``pytest --update-light-references`` writes references.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

__all__ = ["same_light"]

#: Option of pytest by which ``same_light`` writes references instead of comparing with them.
_OPTION = "--update-light-references"

#: Annotations of pictures that differ, for the end of the run.
_ANNOTATIONS: pytest.StashKey[list[str]] = pytest.StashKey()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that writes references.

    Parameters
    ----------
    parser
        Parser of pytest's command line.
    """
    group = parser.getgroup("cboxlab")
    group.addoption(_OPTION, action="store_true", help="Replace the references of same_light.")


@pytest.fixture
def same_light(request: pytest.FixtureRequest) -> Callable[..., None]:
    """Function (name, pictures, *, seed, samples, versions) that compares renderings with a reference.

    It raises AssertionError if the mean light of a surface in a band has changed. Its arguments are the name of the
    reference; a spectral cube or a picture of any scene, several joined by commas, or a folder of independent ones;
    the seed, the samples per pixel and the versions of the renderer, which the reference states. A single picture may
    state no errors.

    Parameters
    ----------
    request
        The test that asks for the fixture; references lie in the folder ``references`` next to its file.

    Returns
    -------
    Callable
        The function.
    """
    folder = request.path.parent / "references"
    update = bool(request.config.getoption(_OPTION))

    def check(
        name: str, pictures: str | Path, *, seed: int, samples: int, versions: Mapping[str, str] | None = None
    ) -> None:
        """Compare with the reference, or write it under the option."""
        from cboxlab.validation.compare_renders.regress import assert_same_light, read_side
        from cboxlab.validation.compare_renders.scene_pictures import cube_paths
        from cboxlab.validation.compare_renders.stored_references import (
            measured_reference,
            read_reference,
            require_same_light,
            write_reference,
        )

        paths = cube_paths(str(pictures))
        side = read_side(paths)
        measured = None if side.variance is None else measured_reference(side, seed, samples, versions or {})
        means, copy = folder / f"{name}.json", folder / f"{name}{Path(paths[0]).suffix}"
        if update:
            if measured is None or (len(paths) == 1 and not measured.precise):
                _copy(Path(paths[0]), copy)
                means.unlink(missing_ok=True)
            else:
                write_reference(means, measured)
                copy.unlink(missing_ok=True)
            return
        if not (means.exists() or copy.exists()):
            pytest.fail(f"{means} or {copy.name}: no reference. Look at the picture, then write it: pytest {_OPTION}")
        try:
            if measured is None or not means.exists():
                assert_same_light(copy, paths[0])
            else:
                require_same_light(read_reference(means), measured)
        except AssertionError as error:
            file, line, _ = request.node.location
            annotations = request.config.stash.setdefault(_ANNOTATIONS, [])
            annotations.append(_annotation(file, 1 if line is None else line + 1, name, str(error)))
            raise

    return check


def _copy(picture: Path, path: Path) -> None:
    """Copy a picture to a reference, the folder included."""
    from cboxlab.utils.files import replacing

    with replacing(path) as temporary:
        temporary.write_bytes(picture.read_bytes())


def _annotation(file: str, line: int, name: str, message: str) -> str:
    """Workflow command of GitHub Actions that shows a message at a test."""
    text = message.replace("%", "%25").replace("\n", "%0A")
    return f"::error file={file},line={line},title=same_light {name}::{text}"


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print an annotation for each picture that differs, where GitHub Actions runs the tests.

    Parameters
    ----------
    terminalreporter
        Reporter of pytest.
    config
        Configuration of pytest.
    """
    if os.environ.get("GITHUB_ACTIONS"):
        for line in config.stash.get(_ANNOTATIONS, []):
            terminalreporter.write_line(line)
