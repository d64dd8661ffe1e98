"""Report of a validation or diagnosis: report.html, metrics.json, maps, and texts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .bands import named_bands
    from .blocks import ReportSection
    from .diagnosis import (
        diagnosis_record,
        explained_share,
        finding_sentences,
        path_steps,
        ranked_values,
        step_name,
        write_diagnosis,
    )
    from .figures import FIGURES, comparison_figure
    from .metrics import PathStep
    from .page import write_tables
    from .plots import STYLE, map_next_to, picture_row
    from .table_sections import correlation_section
    from .trend import TrendResult, read_trend_result, trend_finding, trend_record, trend_rows, write_trend
    from .verdict import chi2_by_place, report_verdict
    from .write import validation_record, write_validation

__all__ = [
    "FIGURES",
    "STYLE",
    "PathStep",
    "ReportSection",
    "TrendResult",
    "chi2_by_place",
    "comparison_figure",
    "correlation_section",
    "diagnosis_record",
    "explained_share",
    "finding_sentences",
    "map_next_to",
    "named_bands",
    "path_steps",
    "picture_row",
    "ranked_values",
    "read_trend_result",
    "report_verdict",
    "step_name",
    "trend_finding",
    "trend_record",
    "trend_rows",
    "validation_record",
    "write_diagnosis",
    "write_tables",
    "write_trend",
    "write_validation",
]

__getattr__, __dir__ = lazy_names(__name__)
