"""Comparison of renders: image stacks, regression, stored references, other renderers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .stack_comparison import StackComparison, compare_stacks, comparison_record, write_comparison
    from .stacks import ImageStack, read_compared, read_stack

__all__ = [
    "ImageStack",
    "StackComparison",
    "compare_stacks",
    "comparison_record",
    "read_compared",
    "read_stack",
    "write_comparison",
]

__getattr__, __dir__ = lazy_names(__name__)
