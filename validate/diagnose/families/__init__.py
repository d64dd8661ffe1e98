"""Families of explanations: one file each.

Other packages add theirs through the entry point group ``cboxlab.families``.
"""

from __future__ import annotations

from functools import lru_cache

from cboxlab.utils.other_packages import loaders_of, records_in, with_others

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
    members = with_others(records_in(__name__, "FAMILY"), loaders_of(_GROUP, Family), checked_family)
    return {family.id: family for family in sorted(members.values(), key=lambda member: (member.order, member.id))}
