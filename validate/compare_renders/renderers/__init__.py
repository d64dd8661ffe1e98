"""Other renderers: which are installed, what they make of a box, how it differs from ours and why."""

from .comparing import ComparedRenderers, compare_renderers
from .exporting import exported_model
from .judging import Judged, judge, reference_cube, write_bias_map
from .references import REFERENCES, Measured, measure_references
from .running import Run, missing, run_renderer

__all__ = [
    "REFERENCES",
    "ComparedRenderers",
    "Judged",
    "Measured",
    "Run",
    "compare_renderers",
    "exported_model",
    "judge",
    "measure_references",
    "missing",
    "reference_cube",
    "run_renderer",
    "write_bias_map",
]
