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

from cboxlab.utils.errors import InputError
from cboxlab.utils.other_packages import entries_of, guarded, loaded

from ._of_other_packages import checked_cause
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
        If an entry point or a file cannot be loaded, holds no sound Cause, or has the identifier of another.
    """
    names = [m.name for m in iter_modules(__path__) if m.name != "cause" and not m.name.startswith("_")]
    modules = [import_module(f"{__name__}.{name}") for name in names]
    catalogue: dict[str, Cause] = {module.CAUSE.id: module.CAUSE for module in modules}
    others = [(where, partial(loaded, where, entry, Cause)) for where, entry in entries_of(_GROUP)]
    files = [Path(text) for text in os.environ.get(_FILES, "").split(os.pathsep) if text]
    others += [(str(file), partial(_of_file, file)) for file in files]
    for where, load in others:
        cause = checked_cause(load(), where)
        if cause.id in catalogue:
            raise InputError(where, f"'{cause.id}', which is there already", "another identifier")
        catalogue[cause.id] = cause
    return tuple(catalogue[name] for name in sorted(catalogue))


def _of_file(file: Path) -> Cause:
    """``CAUSE`` of a Python file."""
    spec = spec_from_file_location(f"regress_cause_{file.stem}", file)
    if spec is None or spec.loader is None or not file.is_file():
        raise InputError(file, "no such Python file", "a Cause named CAUSE")
    module = module_from_spec(spec)
    with guarded(str(file), "a Cause named CAUSE"):
        spec.loader.exec_module(module)
    cause = getattr(module, "CAUSE", None)
    if not isinstance(cause, Cause):
        raise InputError(file, f"a {type(cause).__name__}", "a Cause named CAUSE")
    return cause
