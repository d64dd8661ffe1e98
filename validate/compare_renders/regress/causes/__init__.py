"""Catalogue of causes: one file each, and those of other packages.

Other packages add causes through the entry point group ``cboxlab.regress_causes``. A file is named by the variable
``CBOXLAB_REGRESS_CAUSES``.
"""

from __future__ import annotations

import os
from functools import lru_cache, partial
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from pkgutil import iter_modules

from cboxlab.utils.plug_ins import add_record, add_records, loaded_record

from .cause import Cause, Pictures, SceneLight, Trial, as_found

__all__ = ["Cause", "Pictures", "SceneLight", "Trial", "as_found", "causes"]

#: Entry points of this group are causes of other packages.
_GROUP = "cboxlab.regress_causes"
#: Variable of the environment that names files with a ``CAUSE``, separated as in a search path.
_FILES = "CBOXLAB_REGRESS_CAUSES"


@lru_cache(maxsize=1)
def causes() -> tuple[Cause, ...]:
    """All causes, in the alphabetical order of their identifiers.

    Returns
    -------
    tuple of Cause
        The causes; the result is cached.

    Raises
    ------
    InputError
        If an entry point or a file cannot be loaded, holds no Cause, or has the identifier of another.
    """
    modules = [import_module(f"{__name__}.{m.name}") for m in iter_modules(__path__) if m.name != "cause"]
    catalogue: dict[str, Cause] = {module.CAUSE.id: module.CAUSE for module in modules}
    add_records(catalogue, _GROUP, Cause)
    for file in os.environ.get(_FILES, "").split(os.pathsep):
        if file:
            add_record(catalogue, file, loaded_record(file, partial(_of_file, Path(file)), Cause))
    return tuple(catalogue[name] for name in sorted(catalogue))


def _of_file(file: Path) -> object:
    """``CAUSE`` of a Python file."""
    spec = spec_from_file_location(f"regress_cause_{file.stem}", file)
    if spec is None or spec.loader is None or not file.is_file():
        raise FileNotFoundError("no such Python file")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return getattr(module, "CAUSE", None)
