"""One rendering against another: regression, planes of cubes, stored references, other renderers."""

from .stacks import StackComparison, compare_stacks, comparison_record, read_stack, write_comparison

__all__ = [
    "StackComparison",
    "compare_stacks",
    "comparison_record",
    "read_stack",
    "write_comparison",
]
