"""report.html: one self-contained page that says whether noise explains the difference, and where not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cboxlab.calibration.colorimetry import FilterWeights
from cboxlab.calibration.sensor_equation import BandResponse
from cboxlab.scenes.files import replacing
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from numpy.typing import NDArray

from .blocks import ReportSection, Table
from .colour_difference import srgb_preview
from .compare import Comparison
from .metrics import Run
from .picture_sections import maps_section, residual_section, scatter_section, weights_section
from .plots import Drawing, MapRow, diverging_scale, map_row, picture_row
from .table_sections import camera_section, masks_section, tables_section
from .verdict import verdict, warnings

__all__ = ["ReportInputs", "build_report"]


@dataclass(frozen=True, eq=False)
class ReportInputs:
    """Everything a report shows.

    assumptions : sentences on what was taken for granted. weights, responses : filter weights and what
    they were fitted to, left out where unknown. sections : further ones (a diagnosis), shown after the
    tables. further_warnings : beside those the figures give.
    """

    comparison: Comparison
    run: Run
    assumptions: Sequence[str]
    weights: FilterWeights | None = None
    responses: Sequence[BandResponse] = ()
    sections: Sequence[ReportSection] = ()
    further_warnings: Sequence[str] = ()


def _block_kind(block: object) -> str:
    kinds = {MapRow: "maps", Drawing: "drawing", Table: "table"}
    return kinds[type(block)]


def _figures(c: Comparison) -> list[tuple[str, str, str]]:
    """(what, value, note) of the headline."""
    return [
        ("χ² per degree of freedom", f"{c.chi2.per_dof:.3g}", f"noise alone 1 ± {c.chi2.per_dof_sigma:.2g}"),
        ("mean ΔE*ab", f"{c.delta_e_ab.mean:.2f}", f"noise alone {c.delta_e_ab_noise.mean:.2f}"),
        ("mean CIEDE2000", f"{c.delta_e_2000.mean:.2f}", f"noise alone {c.delta_e_2000_noise.mean:.2f}"),
        ("mean luminance difference", f"{100 * c.luminance.mean:+.2f} %".replace("-", "−"),
         f"rms {100 * c.luminance.rms:.2f} %, noise alone {100 * c.luminance.rms_noise:.2f} %"),
        ("render noise / sensor noise", f"{c.render_sigma_over_sensor_sigma:.2f}",
         "median of standard deviations"),
        ("pixels used", f"{c.pixels_used:,}".replace(",", "\u202f"),
         f"of {c.maps.sizes['x']} × {c.maps.sizes['y']}"),
    ]  # fmt: skip


def _pictures(c: Comparison) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    measured, rendered = (
        srgb_preview(c.maps[f"xyz_{which}"].values, c.white) for which in ("measured", "rendered")
    )
    return measured, rendered


def build_report(path: Path, inputs: ReportInputs) -> None:
    """Write the report, complete or not at all. It refers to nothing outside itself."""
    c, run = inputs.comparison, inputs.run
    measured, rendered = _pictures(c)
    slider = picture_row({"Photograph": measured, "Render": rendered})
    signed = 100 * c.maps["luminance_relative_difference"].values
    scale = diverging_scale(signed, "% (measured − rendered) / rendered", 1.0)
    sections = [
        maps_section(c), residual_section(c), scatter_section(c), tables_section(c),
        *inputs.sections,
        camera_section(run), masks_section(c),
    ]  # fmt: skip
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"), autoescape=True,
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.globals["kind"] = _block_kind
    page = environment.get_template("report.html.j2").render(
        run=run, verdict=verdict(c), findings=[s.finding for s in inputs.sections if s.finding], figures=_figures(c),
        warnings=[*warnings(c, run), *inputs.further_warnings],
        slider=slider.panels,
        trio=[*slider.panels, *map_row({"Luminance difference": signed}, scale).panels], trio_scale=scale,
        sections=sections, assumptions=inputs.assumptions,
        weights=None if inputs.weights is None else weights_section(inputs.weights, inputs.responses),
    )  # fmt: skip
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
