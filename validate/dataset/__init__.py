"""Data sets of synthetic pictures: their making, their files, their checks."""

from .create import DatasetRun, Workers, create_dataset, read_recipe
from .opened import Arrays, Dataset, open_dataset
from .preview import preview_recipe
from .workers import FolderTask, on_scheduler, run_from_folder

__all__ = [
    "Arrays",
    "Dataset",
    "DatasetRun",
    "FolderTask",
    "Workers",
    "create_dataset",
    "on_scheduler",
    "open_dataset",
    "preview_recipe",
    "read_recipe",
    "run_from_folder",
]
