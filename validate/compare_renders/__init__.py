"""Comparison of renders: image stacks, regression, stored references, other renderers."""

from .stack_comparison import StackComparison, compare_stacks, comparison_record, write_comparison
from .stacks import ImageStack, read_stack

__all__ = [
    "ImageStack",
    "StackComparison",
    "compare_stacks",
    "comparison_record",
    "read_stack",
    "write_comparison",
]
