"""Families of explanations: one file each.

Other packages add theirs through the entry point group ``cboxlab.families``.
"""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from pkgutil import iter_modules

from cboxlab.utils.errors import InputError
from cboxlab.utils.other_packages import entries_of, loaded

from ..field_fit import Family
from ._of_other_packages import checked_family

__all__ = ["families"]

#: Entry points of this group are families of other packages.
_GROUP = "cboxlab.families"


@lru_cache(maxsize=1)
def families() -> dict[str, Family]:
    """All families by identifier, those of other packages included.

    Returns
    -------
    dict
        Families in the sequence of their ``order``, equal orders by identifier.

    Raises
    ------
    InputError
        If an entry point cannot be loaded, is no sound Family, or has the identifier of another.
    """
    names = [module.name for module in iter_modules(__path__) if not module.name.startswith("_")]
    members: dict[str, Family] = {}
    for name in names:
        family = import_module(f"{__name__}.{name}").FAMILY
        members[family.id] = family
    for where, entry in entries_of(_GROUP):
        family = checked_family(loaded(where, entry, Family), where)
        if family.id in members:
            raise InputError(where, f"'{family.id}', the identifier of another family", "a new identifier")
        members[family.id] = family
    return {family.id: family for family in sorted(members.values(), key=lambda member: (member.order, member.id))}
