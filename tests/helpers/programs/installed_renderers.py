"""The package ``render/export/own_package``, installed as pip would do it, without a network."""

import importlib
import shutil
import sys
import tomllib
from contextlib import contextmanager
from pathlib import Path

from cboxlab.rendering.export import renderer_catalogue

PACKAGE = Path(__file__).parents[2] / "render" / "export" / "own_package"


@contextmanager
def own_renderers(site):
    """Puts the package and the record of its entry points into the folder ``site`` and that on the path."""
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(PACKAGE / "flat_renderer", site / "flat_renderer", ignore=ignored)
    record = site / f"flat_renderer-{project['version']}.dist-info"
    record.mkdir()
    (record / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    lines = [f"{name} = {value}" for name, value in project["entry-points"]["cboxlab.renderers"].items()]
    (record / "entry_points.txt").write_text("\n".join(["[cboxlab.renderers]", *lines, ""]))
    sys.path.insert(0, str(site))
    importlib.invalidate_caches()
    renderer_catalogue.cache_clear()
    try:
        yield
    finally:
        sys.path.remove(str(site))
        sys.modules.pop("flat_renderer", None)
        renderer_catalogue.cache_clear()
