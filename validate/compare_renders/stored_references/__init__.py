"""Stored references of a picture's mean light, which change only by an explicit command."""

from .stored import Reference, measured_reference, read_reference, require_same_light, write_reference

__all__ = ["Reference", "measured_reference", "read_reference", "require_same_light", "write_reference"]
