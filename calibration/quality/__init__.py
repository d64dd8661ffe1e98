"""Suspected errors of a capture, detected in its frames, tables and numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .find import find_suspicions
    from .frame_checks import Suspicion
    from .levels import centre_nm, power_law
    from .points import distance_to_surface, explain_points

__all__ = ["Suspicion", "centre_nm", "distance_to_surface", "explain_points", "find_suspicions", "power_law"]

__getattr__, __dir__ = lazy_names(__name__)
