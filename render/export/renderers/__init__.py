"""Catalogue of renderers: one file each, with the record RENDERER; entry points add others."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType

from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import suggestion
from cboxlab.utils.other_packages import loaders_of, records_in, with_others

from ._of_other_packages import checked_renderer
from .renderer import PYTHON_SCRIPT, SHELL_SCRIPT, Renderer

__all__ = ["PYTHON_SCRIPT", "SHELL_SCRIPT", "Renderer", "renderer_catalogue", "renderer_of"]

#: Entry point group of other packages' renderers.
_GROUP = "cboxlab.renderers"
#: Modules of this package that hold no renderer.
_NO_RENDERER = {"renderer"}


@lru_cache(maxsize=1)
def renderer_catalogue() -> Mapping[str, Renderer]:
    """All renderers by identifier, in alphabetical order, those of other packages included.

    Returns
    -------
    Mapping
        Identifier to renderer.

    Raises
    ------
    InputError
        If an entry point of the group ``cboxlab.renderers`` cannot be loaded, is no sound Renderer, or bears the
        identifier of another one.
    """
    ours = records_in(__name__, "RENDERER", _NO_RENDERER)
    catalogue = with_others(ours, loaders_of(_GROUP, Renderer), checked_renderer)
    return MappingProxyType(dict(sorted(catalogue.items())))


def renderer_of(identifier: str, where: str = "renderer") -> Renderer:
    """Renderer with an identifier.

    Parameters
    ----------
    identifier
        Its identifier.
    where
        Source of the identifier, for the message.

    Returns
    -------
    Renderer
        The renderer.

    Raises
    ------
    InputError
        If there is none; the message suggests a similar identifier.
    """
    catalogue = renderer_catalogue()
    if identifier not in catalogue:
        allowed = f"one of {', '.join(catalogue)}"
        raise InputError(where, f"'{identifier}'", allowed, suggestion(identifier, catalogue))
    return catalogue[identifier]
