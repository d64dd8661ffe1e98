"""The page report.html, which refers to no other files.

The result comes first, then the comparison, where the model fails, and what it lacks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cboxlab.calibration.colour import FilterWeights
from cboxlab.calibration.instrument import BandResponse, band_centres
from cboxlab.calibration.quality import Suspicion
from cboxlab.utils.files import replacing
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.page_text import unbroken
from cboxlab.utils.table import Table
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ..compare import COLOUR_DIFFERENCES, Comparison
from .bands import named_bands
from .blocks import Cell, ReportSection, ReportTable, Story
from .metrics import ValidationFacts
from .numerals import chi2_text
from .picture_sections import band_maps, maps_section, residual_section, scatter_section, story_without, weights_section
from .plots import Drawing, MapRow
from .table_sections import camera_section, masks_section, tables_section, where_section
from .verdict import report_verdict, warnings
from .viewer import picture_data, viewer_fragment

__all__ = ["ReportInputs", "build_report", "report_environment"]

#: Start of a note among the sentences of a command.
_BULLET = "• "


@dataclass(frozen=True, eq=False)
class ReportInputs(FrozenMappings):
    """Content of a report."""

    #: The comparison.
    comparison: Comparison
    #: Data of the validation.
    run: ValidationFacts
    #: Assumptions, one sentence each.
    assumptions: Sequence[str]
    #: Filter weights; their section is left out where None.
    weights: FilterWeights | None = None
    #: Responses that the weights were fitted to; empty if not known.
    responses: Sequence[BandResponse] = ()
    #: Chapters of a diagnosis; None without a diagnosis.
    story: Story | None = None
    #: Data of the viewer; those of the comparison alone where None.
    viewer: Mapping[str, Any] | None = None
    #: Further sections, folded.
    sections: Sequence[ReportSection] = ()
    #: Warnings in addition to those derived from the results.
    further_warnings: Sequence[str] = ()
    #: Suspected errors of the capture.
    suspicions: Sequence[Suspicion] = ()
    #: (name, value) of command, date, versions and seeds.
    provenance: Sequence[tuple[str, str]] = ()


def _block_kind(block: object) -> str:
    kinds = {MapRow: "maps", Drawing: "drawing", ReportTable: "table"}
    return kinds[type(block)]


def _figures(c: Comparison) -> list[tuple[str, str, str]]:
    """(name, value, note) of the headline figures."""
    return [
        ("χ² per degree of freedom", chi2_text(c.chi2.per_dof), f"noise alone 1 ± {c.chi2.per_dof_sigma:.2g}"),
        *(
            (
                f"mean {COLOUR_DIFFERENCES[name].label}",
                f"{figures.mean:.2f}",
                f"noise alone {c.colour_noise[name].mean:.2f}",
            )
            for name, figures in c.colour.items()
        ),
        (
            "mean luminance difference",
            f"{100 * c.luminance.mean:+.2f} %".replace("-", "−"),
            f"rms {100 * c.luminance.rms:.2f} %, noise alone {100 * c.luminance.rms_noise:.2f} %",
        ),
        ("rendering noise / sensor noise", f"{c.render_sigma_over_sensor_sigma:.2f}", "median of standard deviations"),
        ("pixels used", f"{c.pixels_used:,}".replace(",", "\u202f"), f"of {c.maps.sizes['x']} × {c.maps.sizes['y']}"),
    ]


def _provenance_section(rows: Sequence[tuple[str, str]]) -> ReportSection:
    table = ReportTable(("what", "value"), [(what, Cell(value, wrap=True)) for what, value in rows])
    return ReportSection("Command, date, versions, seeds", (), (table,))


def report_environment() -> Environment:
    """Templates of the pages.

    Returns
    -------
    Environment
        Jinja's environment, which escapes text.
    """
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        finalize=unbroken,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["kind"] = _block_kind
    return environment


def write_sections(path: Path, title: str, sections: Sequence[ReportSection]) -> None:
    """Write a page of sections; an incomplete file is removed.

    Parameters
    ----------
    path
        File to write.
    title
        Title of the page.
    sections
        The sections in their order.
    """
    page = report_environment().get_template("plain.html.j2").render(title=title, sections=sections)
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def write_tables(
    path: Path,
    title: str,
    sentences: Sequence[str],
    tables: Sequence[Table],
    pictures: Sequence[ReportSection] = (),
) -> None:
    """Write a page of sentences, pictures and tables; an incomplete file is removed.

    Parameters
    ----------
    path
        File to write.
    title
        Title of the page.
    sentences
        Sentences, the first one as the heading of the rest. Those that begin with a bullet become the notes at the end.
    tables
        Tables of text.
    pictures
        Sections between sentences and tables.
    """
    first, *others = sentences
    notes = [text.removeprefix(_BULLET) for text in others if text.startswith(_BULLET)]
    head = ReportSection(first, [text for text in others if not text.startswith(_BULLET)])
    below = [ReportSection(table.title, blocks=(ReportTable(table.columns, table.rows),)) for table in tables]
    last = [ReportSection("Notes", steps=notes)] if notes else []
    write_sections(path, title, [head, *pictures, *below, *last])


def build_report(path: Path, inputs: ReportInputs) -> None:
    """Write the report; an incomplete file is removed.

    Parameters
    ----------
    path
        File to write.
    inputs
        Content of the report.
    """
    c, run, responses = inputs.comparison, inputs.run, inputs.responses
    bands = named_bands(c.bands, responses)
    story = inputs.story or story_without(c, bands)
    data = inputs.viewer or picture_data(c, band_centres(responses) if responses else None)
    where = where_section(c, bands, run.failures, band_maps(c, bands))
    chapters = [where, story.missing, *story.unexplained, story.falling, story.next]
    folded = [
        tables_section(c, bands),
        maps_section(c),
        residual_section(c),
        scatter_section(c),
        *inputs.sections,
        camera_section(run),
        masks_section(c),
        ReportSection("Assumptions", steps=inputs.assumptions),
    ]
    if inputs.weights is not None:
        folded.append(weights_section(inputs.weights, responses))
    if inputs.provenance:
        folded.append(_provenance_section(inputs.provenance))
    page = (
        report_environment()
        .get_template("report.html.j2")
        .render(
            run=run,
            headline=story.headline,
            level=report_verdict(c).level,
            as_given=story.falling is not None,
            figures=_figures(c),
            warnings=[*warnings(c, run), *inputs.further_warnings],
            suspicions=inputs.suspicions,
            viewer=viewer_fragment(data, "viewer", {"link": True}),
            chapters=[chapter for chapter in chapters if chapter is not None],
            folded=folded,
            provenance=dict(inputs.provenance),
        )
    )
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
