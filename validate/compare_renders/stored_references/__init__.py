"""Stored references of a picture's mean light, which change by an explicit command alone."""

from .stored import Reference, measured_reference, read_reference, require_same_light, write_reference

__all__ = ["Reference", "measured_reference", "read_reference", "require_same_light", "write_reference"]
