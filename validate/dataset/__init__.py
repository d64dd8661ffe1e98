"""Data sets of synthetic pictures: their making, their files, their checks."""

from .create import DatasetRun, Workers, create_dataset, read_recipe
from .opened import Arrays, Dataset, open_dataset
from .preview import preview_recipe
from .workers import on_scheduler

__all__ = [
    "Arrays",
    "Dataset",
    "DatasetRun",
    "Workers",
    "create_dataset",
    "on_scheduler",
    "open_dataset",
    "preview_recipe",
    "read_recipe",
]
