"""The package ``render/effects/own_package``, installed as pip would do it, without a network."""

import importlib
import shutil
import sys
import tomllib
from contextlib import contextmanager
from pathlib import Path

from cboxlab.rendering.effects import catalogue

PACKAGE = Path(__file__).parents[2] / "render" / "effects" / "own_package"


@contextmanager
def own_effects(site):
    """Puts the package and the record of its entry points into the folder ``site`` and that on the path."""
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]
    shutil.copytree(PACKAGE / "own_effects", site / "own_effects", ignore=shutil.ignore_patterns("__pycache__"))
    record = site / f"own_effects-{project['version']}.dist-info"
    record.mkdir()
    (record / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    lines = [f"{name} = {value}" for name, value in project["entry-points"]["cboxlab.effects"].items()]
    (record / "entry_points.txt").write_text("\n".join(["[cboxlab.effects]", *lines, ""]))
    sys.path.insert(0, str(site))
    importlib.invalidate_caches()
    catalogue.cache_clear()
    try:
        yield
    finally:
        sys.path.remove(str(site))
        for name in [name for name in sys.modules if name.split(".")[0] == "own_effects"]:
            del sys.modules[name]
        catalogue.cache_clear()
