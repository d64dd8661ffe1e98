"""Spot of a difference: a map in standard errors, and one sentence."""

from .spot import Spot, spot_of

__all__ = ["Spot", "spot_of"]
