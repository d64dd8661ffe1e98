"""Renderers of other packages: their record, and what their functions give."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.other_packages import (
    checked_function,
    guarded,
    is_identifier,
    is_tuple_of,
    require,
    require_fields,
)
from numpy.typing import NDArray

from ..neutral import Layout
from .renderer import Renderer

__all__ = ["checked_renderer"]

#: Requirement of ``write``, in messages.
_FILES = "the scene's files from its function"
#: Requirement of ``read``.
_PIXELS = "renderings"
#: Requirement of ``environment``.
_VARIABLES = "environment variables"


def checked_renderer(renderer: Renderer, where: str) -> Renderer:
    """Renderer of another package whose functions' faults are InputErrors.

    Parameters
    ----------
    renderer
        The renderer as the package has it.
    where
        The entry point, for messages.

    Returns
    -------
    Renderer
        A copy. Its functions raise InputError where those of the package raise any exception, or give a value of
        another type, of another size, or with numbers that are not finite.

    Raises
    ------
    InputError
        For fields of another type than those of ``Renderer``.
    """
    texts = (renderer.name, renderer.package, renderer.package_of_programs)
    sound = {
        "id": is_identifier(renderer.id),
        "name or package": is_tuple_of(str, texts),
        "command": is_tuple_of(str, renderer.command) and bool(renderer.command),
        "programs": is_tuple_of(str, renderer.programs),
        "pixels": renderer.pixels in ("film", "rays"),
        "write, read or environment": all(map(callable, (renderer.write, renderer.read, renderer.environment))),
    }
    require_fields(where, renderer, sound)
    with guarded(where, "a command whose only place for a word is {python}"):
        for part in renderer.command:
            part.format(python="python")

    def pixels(value: Any, folder: Path, layout: Layout) -> NDArray:
        return _checked_pixels(value, layout, renderer.pixels, where)

    def variables(value: Any) -> Mapping[str, str]:
        mapping = isinstance(value, Mapping) and is_tuple_of(str, (*value.keys(), *value.values()))
        require(mapping, where, f"a {type(value).__name__} that is no mapping of texts", _VARIABLES)
        return dict(value)

    return replace(
        renderer,
        write=checked_function(renderer.write, where, _FILES, lambda *_: None),
        read=checked_function(renderer.read, where, _PIXELS, pixels),
        environment=checked_function(renderer.environment, where, _VARIABLES, variables),
    )


def _checked_pixels(value: Any, layout: Layout, kind: str, where: str) -> NDArray:
    """Renderings of the layout's size. Raises InputError for others."""
    require(isinstance(value, np.ndarray), where, f"a {type(value).__name__}", "an array of radiances")
    settings = layout.settings
    shape = (settings.batches, layout.film_height_px, layout.film_width_px, layout.channels)
    size = int(np.prod(shape))
    if kind == "rays":
        size = settings.batches * layout.height_px * layout.width_px * settings.subpixels**2 * layout.channels
    sound = value.dtype.kind in "fiu" and (value.size == size if kind == "rays" else value.shape == shape)
    expected = f"{size} numbers" if kind == "rays" else f"numbers of shape {shape}"
    require(sound, where, f"{value.dtype} of shape {value.shape}", expected)
    require(bool(np.isfinite(value).all()), where, "pixels that are not finite", "finite radiances")
    return np.asarray(value)
