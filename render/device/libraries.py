"""Dr.Jit and Mitsuba, imported when they are first used.

Dr.Jit loads LLVM while it is imported. Mitsuba offers its types only under an active variant, which belongs to one
thread. Imported by the modules that use them, the two would settle both for the whole process. Instead `dr` and `mi`
stand for the two modules. Every use goes to the module itself, the first one in a thread after `variant.ensure`.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from .variant import ensure

__all__ = ["dr", "mi"]

if TYPE_CHECKING:
    import drjit as dr
    import mitsuba as mi
else:

    class _Library:
        def __init__(self, name: str) -> None:
            self._name = name

        def __getattr__(self, attribute: str) -> Any:
            ensure()
            return getattr(sys.modules[self._name], attribute)

    dr, mi = _Library("drjit"), _Library("mitsuba")
