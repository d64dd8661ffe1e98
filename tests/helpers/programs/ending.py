"""A task whose first worker ends; a module that loads nothing."""

import os


def ends_once(mark):
    """Records of a task whose first worker ends without a word."""
    if not mark.exists():
        mark.touch()
        os._exit(1)
    return [{"box": mark.name}]
