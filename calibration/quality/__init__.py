"""Suspected errors of a capture, detected in its frames, tables and numbers."""

from .find import find_suspicions
from .geometry import explain_points
from .suspicion import Suspicion

__all__ = ["Suspicion", "explain_points", "find_suspicions"]
