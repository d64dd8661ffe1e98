"""Other renderers on one box: runs of those installed, and their differences from ours."""

from .closed_form_scenes import CLOSED_FORM_SCENES, Measured, closed_form_table, measure_closed_forms
from .comparing import ComparedRenderers, compare_renderers
from .exporting import exported_model
from .judging import Judged, judge, reference_cube, write_bias_map
from .running import RendererRun, missing, run_renderer

__all__ = [
    "CLOSED_FORM_SCENES",
    "ComparedRenderers",
    "Judged",
    "Measured",
    "RendererRun",
    "closed_form_table",
    "compare_renderers",
    "exported_model",
    "judge",
    "measure_closed_forms",
    "missing",
    "reference_cube",
    "run_renderer",
    "write_bias_map",
]
