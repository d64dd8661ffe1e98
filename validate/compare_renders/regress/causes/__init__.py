"""Catalogue of causes: one file each, and those of other packages.

Other packages add causes through the entry point group ``cboxlab.regress_causes``. A file is named by the variable
``CBOXLAB_REGRESS_CAUSES``.
"""

from __future__ import annotations

import os
from functools import lru_cache, partial
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

from cboxlab.utils.errors import InputError
from cboxlab.utils.other_packages import guarded, loaders_of, records_in, with_others

from ._of_other_packages import checked_cause
from .cause import Cause, Pictures, SceneLight, Trial, fixed_values

__all__ = ["Cause", "Pictures", "SceneLight", "Trial", "causes", "fixed_values"]

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
    files = [Path(text) for text in os.environ.get(_FILES, "").split(os.pathsep) if text]
    loaders = loaders_of(_GROUP, Cause)
    loaders += [(str(file), partial(_of_file, file)) for file in files]
    catalogue = with_others(records_in(__name__, "CAUSE", ("cause",)), loaders, checked_cause)
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
