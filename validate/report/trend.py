"""Comparison of several results by their figures and fitted numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.input_files import read_json
from scipy.stats import norm

from .blocks import ReportSection, ReportTable
from .numerals import number, with_error
from .page import write_sections
from .plots import INK, LINE, STYLE, Drawing, drawing, new_figure

__all__ = ["TrendResult", "read_trend_result", "trend_finding", "trend_record", "trend_rows", "write_trend"]

#: Unit at the end of the names of shares, which are printed in percent.
_PERCENT_SIGN = "%"

#: Factor from shares to percent.
_PERCENT = 100.0

#: Figures of metrics.json by the keys that lead to them: name, value, standard deviation or None.
_FIGURES: tuple[tuple[str, tuple[str, ...], tuple[str, ...] | None], ...] = (
    ("χ² per degree of freedom", ("chi2_per_dof",), ("chi2_per_dof_sigma",)),
    ("mean ΔE*ab", ("delta_e_ab", "mean"), None),
    ("mean CIEDE2000", ("delta_e_2000", "mean"), None),
    (f"rms luminance difference, {_PERCENT_SIGN}", ("luminance", "rms_relative_difference"), None),
    ("lamp scale", ("lamp_scale", "value"), ("lamp_scale", "sigma")),
    ("camera, focal length, px", ("camera_refitted", "focal_length_px"), None),
    ("camera, k1", ("camera_refitted", "k1"), None),
)

#: Probability that noise alone makes the largest of all compared changes significant.
_SIGNIFICANT = 0.01

#: Digits of the difference between the largest and the smallest value, in a row without standard deviations.
_DIGITS_OF_SPREAD = 2

#: Axes of the camera's position.
_AXES = "xyz"


@dataclass(frozen=True)
class TrendResult(FrozenMappings):
    """Figures and fitted numbers of one result."""

    #: Name, of its folder.
    name: str
    #: Capture that it belongs to.
    capture: str
    #: By name, value and standard deviation; NaN where it is not known.
    numbers: Mapping[str, tuple[float, float]]


def _at(record: Any, keys: Sequence[str]) -> float:
    """Number at nested keys; NaN where it is missing."""
    for key in keys:
        record = record.get(key) if isinstance(record, Mapping) else None
    return float(record) if isinstance(record, int | float) and not isinstance(record, bool) else math.nan


def _numbers(metrics: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> Iterator[tuple[str, tuple[float, float]]]:
    """Name, and value with standard deviation, of every number."""
    for name, keys, sigma in _FIGURES:
        factor = _PERCENT if name.endswith(_PERCENT_SIGN) else 1.0
        yield name, (factor * _at(metrics, keys), math.nan if sigma is None else _at(metrics, sigma))
    position = (metrics.get("camera_refitted") or {}).get("position_mm") or ()
    for axis, value in zip(_AXES, position, strict=False):
        yield f"camera, {axis}, mm", (_at({"value": value}, ("value",)), math.nan)
    for band in sorted(metrics.get("bands", {})):
        yield (
            f"χ² per degree of freedom, {band}",
            (_at(metrics, ("bands", band, "chi2_per_dof")), _at(metrics, ("bands", band, "chi2_per_dof_sigma"))),
        )
    if path := [step for step in metrics.get("path", ()) if step["effects"]]:
        yield "χ² with the effects added", (_at(path[-1], ("chi2_per_dof",)), math.nan)
    sigmas = {entry["effect"]: entry["sigma"] for entry in diagnosis.get("ranking", ())}
    effects = [effect for effect in diagnosis.get("selected", ()) if effect != "unknown"]
    for effect, values in zip(effects, diagnosis.get("selected_parameters", ()), strict=False):
        for key, value in values.items():
            if isinstance(value, int | float):
                yield f"{effect}, {key}", (float(value), _at(sigmas.get(effect, {}), (key,)))


def read_trend_result(folder: Path) -> TrendResult:
    """Figures of a folder that ``cbox validate`` or ``cbox diagnose`` wrote.

    Parameters
    ----------
    folder
        Folder with metrics.json, and diagnosis.json after a diagnosis.

    Returns
    -------
    TrendResult
        Its figures.

    Raises
    ------
    InputError
        For a folder without metrics.json, and for files of another content.
    """
    metrics = read_json(folder / "metrics.json", "the figures of a result")
    path = folder / "diagnosis.json"
    diagnosis = read_json(path, "a diagnosis") if path.exists() else {}
    if not isinstance(metrics, dict) or "chi2_per_dof" not in metrics:
        raise InputError(folder / "metrics.json", "no chi2_per_dof", "the figures of a validation")
    try:
        numbers = dict(_numbers(metrics, diagnosis))
    except (AttributeError, KeyError, TypeError):
        raise InputError(folder, "figures of another form", "results as cbox writes them") from None
    return TrendResult(folder.resolve().name, str(metrics.get("capture", "")), numbers)


def trend_record(results: Sequence[TrendResult]) -> dict[str, Any]:
    """Every number of the results, ready for JSON.

    Parameters
    ----------
    results
        The results in their order.

    Returns
    -------
    dict
        ``results`` (names), ``captures``, and by number ``value`` and ``sigma``, None where a result lacks it.
    """
    columns = {name: [result.numbers.get(name, (math.nan, math.nan)) for result in results] for name in _names(results)}
    return {
        "results": [result.name for result in results],
        "captures": [result.capture for result in results],
        "numbers": {
            name: {
                "value": [None if math.isnan(value) else value for value, _ in column],
                "sigma": [None if math.isnan(sigma) else sigma for _, sigma in column],
            }
            for name, column in columns.items()
        },
    }


def _names(results: Sequence[TrendResult]) -> list[str]:
    """Names of the numbers that any result has, in the order of the first that has them."""
    names = dict.fromkeys(name for result in results for name in result.numbers)
    return [name for name in names if any(math.isfinite(r.numbers.get(name, (math.nan, 0))[0]) for r in results)]


def trend_finding(results: Sequence[TrendResult]) -> str:
    """Sentence on the largest change from one result to the next, in its standard deviations.

    Parameters
    ----------
    results
        The results in their order.

    Returns
    -------
    str
        The number that changes most; or that no change is significant, or none has a known standard deviation.
    """
    changes = []
    for first, second in pairwise(results):
        for name in first.numbers.keys() & second.numbers.keys():
            (before, sigma), (after, sigma_after) = first.numbers[name], second.numbers[name]
            if (error := math.hypot(sigma, sigma_after)) > 0 and math.isfinite(after - before):
                changes.append((abs(after - before) / error, name, first, second))
    if not changes:
        return "No number has a known standard deviation in two successive results."
    limit = float(norm.isf(_SIGNIFICANT / 2 / len(changes)))
    size, name, first, second = max(changes, key=lambda change: change[:2])
    if size <= limit:
        return f"No number changes significantly: none of {len(changes)} by more than {limit:.1f} standard deviations."
    texts = [f"{with_error(*result.numbers[name])} ({result.name})" for result in (first, second)]
    return (
        f"The most significant change is that of '{name}': from {texts[0]} to {texts[1]}, "
        f"{number(size, 1)} standard deviations."
    )


@matplotlib.rc_context(STYLE)
def _curves(results: Sequence[TrendResult]) -> Drawing:
    """One plot for each number, over the results in their order."""
    figures = []
    order = np.arange(len(results))
    for name in _names(results):
        pairs = np.array([result.numbers.get(name, (np.nan, np.nan)) for result in results])
        figure, axes = new_figure(2.4)
        axes.errorbar(order, pairs[:, 0], np.nan_to_num(pairs[:, 1]), fmt="-o", color=LINE, markersize=4, capsize=2)
        axes.set_title(name)
        axes.set_xticks(order, [result.name[:14] for result in results], rotation=20 if len(results) > 3 else 0)
        axes.margins(x=0.12, y=0.2)
        axes.ticklabel_format(axis="y", useOffset=False)  # an offset would stand on the title
        if name.startswith("χ²"):
            axes.axhline(1, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
        figures.append(figure)
    return drawing(*figures)


def _texts(pairs: Sequence[tuple[float, float]]) -> list[str]:
    """Values with their standard deviations, or else with the decimals that differ."""
    values = np.array([value for value, _ in pairs if math.isfinite(value)])
    spread = float(np.ptp(values)) if len(values) else 0.0
    decimals = 0 if spread == 0 else max(0, _DIGITS_OF_SPREAD - 1 - math.floor(math.log10(spread)))
    return [
        "–"
        if not math.isfinite(value)
        else with_error(value, sigma)
        if math.isfinite(sigma) or not decimals
        else f"{value:.{decimals}f}".replace("-", "−")
        for value, sigma in pairs
    ]


def trend_rows(results: Sequence[TrendResult]) -> list[tuple[str, ...]]:
    """Every number of the results as text.

    Parameters
    ----------
    results
        The results in their order.

    Returns
    -------
    list of tuple
        Name of a number, then its value of each result with its standard deviation where known.
    """
    return [
        (name, *_texts([result.numbers.get(name, (math.nan, math.nan)) for result in results]))
        for name in _names(results)
    ]


def write_trend(path: Path, results: Sequence[TrendResult]) -> None:
    """Write the page that compares results; an incomplete file is removed.

    Parameters
    ----------
    path
        File to write.
    results
        The results in their order.
    """
    captures = ", ".join(dict.fromkeys(result.capture for result in results))
    sections = [
        ReportSection("Finding", (trend_finding(results),)),
        ReportSection(
            "Every number", blocks=(ReportTable(("number", *(result.name for result in results)), trend_rows(results)),)
        ),
        ReportSection(
            "Trends",
            ("Bars are one standard deviation where it is known. The dashed line is noise alone.",),
            [_curves(results)],
        ),
    ]
    title = f"{len(results)} results of {captures}"
    write_sections(path, title, sections)
