"""A pytest plugin: the fixture ``same_light`` compares pictures with references stored beside the test.

    def test_box(same_light):
        same_light("box", "box.nc", seed=2, samples=512, versions={"ourrenderer": "3.2"})

compares the means over surfaces and bands with ``references/box.json``. A missing reference is an error. References
are written by ``pytest --update-light-references`` alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

__all__ = ["same_light"]

_OPTION = "--update-light-references"


def pytest_addoption(parser: pytest.Parser) -> None:
    """The explicit command by which references change."""
    group = parser.getgroup("cboxlab")
    group.addoption(_OPTION, action="store_true", help="Write the references of same_light anew.")


@pytest.fixture
def same_light(request: pytest.FixtureRequest) -> Callable[..., None]:
    """A function (name, pictures, *, seed, samples, versions): AssertionError where the mean light has changed.

    pictures : a spectral cube, several joined by commas, or a folder of them (independent cubes of one picture).
    """
    folder = request.path.parent / "references"
    update = bool(request.config.getoption(_OPTION))

    def check(
        name: str, pictures: str | Path, *, seed: int, samples: int, versions: Mapping[str, str] | None = None
    ) -> None:
        from cboxlab.validation.compare_renders.regress import cube_paths, read_side
        from cboxlab.validation.compare_renders.stored_references import (
            measured_reference,
            read_reference,
            require_same_light,
            write_reference,
        )

        path = folder / f"{name}.json"
        side = read_side(cube_paths(str(pictures)))
        measured = measured_reference(side, seed, samples, versions or {})
        if update:
            write_reference(path, measured)
            return
        if not path.exists():
            pytest.fail(f"{path}: no reference. Look at the picture, then write it: pytest {_OPTION}")
        require_same_light(read_reference(path), measured)

    return check
