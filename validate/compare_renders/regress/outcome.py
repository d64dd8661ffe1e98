"""Outcome of a regression: verdict, tests, tables; as JUnit XML and as lines for GitHub."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.distributions import student_quantile
from cboxlab.utils.files import replacing
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.numbers import json_value
from cboxlab.utils.table import Table
from numpy.typing import NDArray

from ..scene_pictures import NotNumbers
from .patterns import CANCELLING, FIXED_TEXTURE, GRIDS, HIDDEN_BY, STRUCTURE, PooledMean
from .where import Spot

__all__ = [
    "UNKNOWN",
    "NamedChange",
    "Outcome",
    "as_percent",
    "change_text",
    "github_lines",
    "name_line",
    "summary",
    "write_junit",
]

#: Identifier of a change that no explanation of the list fits.
UNKNOWN = "unknown"

#: Remaining part of the light below which it is stated itself, not as a difference in per cent.
_LITTLE_LIGHT = 1e-3
#: Largest number of rows in the table of deciding pools.
_MOST_ROWS = 8
#: Largest number of names in sentences.
_MOST_NAMES = 3
#: Deciding pools listed for GitHub.
_MAX_GITHUB_POOLS = 3
#: Sentences on columns of the tables.
_OF_COLUMNS = (
    "Column sigmas: the difference over its standard deviation, which is the column ± %.",
    "Column detectable, %: size of a difference that is found in 90 of 100 runs like this.",
)
#: Probability of the one-sided limit of ``Outcome.equivalence_95``.
_EQUIVALENCE_TAIL = 0.05


@dataclass(frozen=True)
class NamedChange(FrozenMappings):
    """One explanation of a change, with its probability."""

    #: Identifier of the change; "unknown" where no explanation fits.
    change: str
    #: Parameters by name.
    parameters: Mapping[str, Any]
    #: Probability among all explanations.
    probability: float
    #: Chi-square of the remainder per number.
    chi2: float = float("nan")
    #: Whether it leaves no more than noise and the known error of computed shapes.
    fits: bool = True


@dataclass(frozen=True, eq=False)
class Outcome(FrozenMappings):
    """Verdict on two pictures, with its tests and the named change."""

    #: Source of the baseline.
    baseline: str
    #: Source of the candidate.
    candidate: str
    #: All pooled tests, the entire picture first.
    pools: tuple[PooledMean, ...]
    #: Rate of false alarms of the verdict.
    false_alarms: float
    #: Number of pixels set aside as outliers.
    outliers: int
    #: Light set aside in them, relative to all light.
    outlier_share: float
    #: Pixels that differ by themselves (false discovery rate 1 %); they do not enter the verdict.
    pixels_differing: int
    #: (y, x) difference over the baseline, summed over wavelengths; NaN without light.
    relative: NDArray[np.float64]
    #: Explanations of the change, the most probable first; none where the pictures are the same.
    changes: tuple[NamedChange, ...] = ()
    #: Remarks for the reader.
    notes: tuple[str, ...] = ()
    #: Kind of each input by its name, for reports.
    kinds: Mapping[str, str] = field(default_factory=dict)
    #: Whether a side states no noise, so that a texture of single pixels counts as noise.
    single_pictures: bool = False
    #: Whether their noise does not look like that of samples and a pixel filter, as behind a denoiser.
    looks_denoised: bool = False
    #: Where the pictures differ; None where they are the same.
    spot: Spot | None = None
    #: Numbers that baseline and candidate hold, in words; empty where both are as fine as 32-bit floats.
    numbers: tuple[str, str] = ("", "")
    #: Pixels of one side alone that are not numbers, by the side's name; all else is compared without them.
    not_numbers: Mapping[str, NotNumbers] = field(default_factory=dict)

    @property
    def same(self) -> bool:
        """Whether no pool differs significantly."""
        return not any(row.different for row in self.pools)

    @property
    def picture_mean(self) -> PooledMean:
        """Test of the mean over the picture without the lamp."""
        return self.pools[0]

    @property
    def would_have_seen(self) -> float:
        """Relative size of an even change of the light that is found in 90 of 100 runs like this."""
        return min(row.detectable for row in (self.picture_mean, *self.of_kind("even")))

    @property
    def would_have_seen_in_parts(self) -> float:
        """Relative size of a change of one part of the picture that is found in 90 of 100 runs.

        It is that of the median surface, or of the median of 8 x 8 blocks where no surface is known. NaN without parts.
        """
        rows = self.of_kind("surface") or self.of_kind("block")
        return float(np.median([row.detectable for row in rows])) if rows else math.nan

    @property
    def unseen(self) -> str:
        """Size of changes that these pictures cannot show, in words; empty where they differ."""
        parts = self.would_have_seen_in_parts
        if not self.same or not math.isfinite(parts):
            return ""
        part = "a surface" if self.of_kind("surface") else "one of 8 x 8 blocks"
        text = f"Changes of {part} below {100 * parts:.3g} % of its light could not be seen"
        for row in (*self.of_kind("part"), *self.of_kind("motion")):
            edge = round(row.pixels**0.5)
            if math.isfinite(row.detectable):
                size = f"{100 * row.detectable:.3g} %" if row.unit == "1" else f"{row.detectable:.2g} {row.unit}"
                text += f", nor {'' if row.unit == '1' else 'motions '}of {edge} x {edge} px below {size}"
        if self.single_pictures:
            text += ". Another texture of single pixels counts as noise"
            text += ": compare several pictures of other seeds on each side"
        return f"{text}."

    @property
    def of_noise(self) -> str:
        """Sentence on noise that single pictures do not show; empty where they show it."""
        if not self.looks_denoised:
            return ""
        start = "These pictures look denoised" if self.same else "If these pictures are denoised"
        parts, even = self.would_have_seen_in_parts, f"an even change below {100 * self.would_have_seen:.3g} %"
        limit = f"a difference of a part below {100 * parts:.3g} %" if math.isfinite(parts) else f"parts and {even}"
        advice = "Give several pictures of other seeds a side, or raw ones."
        return f"{start}: their noise is not visible, and {limit} cannot be judged. {advice}"

    @property
    def of_numbers(self) -> str:
        """Sentence on the numbers of both sides, which do not decide; empty where they are the same."""
        first, second = self.numbers
        if first == second:
            return ""
        light = (
            "Numbers are stored differently, the light is the same" if self.same else "Numbers are stored differently"
        )
        return f"{light}: the candidate holds {second}, the baseline {first}."

    @property
    def equivalence_95(self) -> float:
        """Relative limit within which the mean light agrees at 95 %."""
        mean = self.picture_mean
        return abs(mean.difference) + float(student_quantile(_EQUIVALENCE_TAIL, mean.degrees)) * mean.sigma

    @property
    def best_name(self) -> NamedChange | None:
        """Most probable explanation but `unknown`; None where there is none."""
        return next((change for change in self.changes if change.change != UNKNOWN), None)

    @property
    def left_chi2_per_number(self) -> float:
        """Chi-square per number that the best name leaves; noise gives about 1. NaN without a name."""
        return float("nan") if self.best_name is None else self.best_name.chi2

    @property
    def fits(self) -> bool | None:
        """Whether the best name leaves no more than noise and error of shapes; None without one."""
        return None if self.best_name is None else self.best_name.fits

    @property
    def cancelling(self) -> str | None:
        """Pattern whose means cancel, in words; None without one that decides.

        A periodic pattern explains steps, lines, tiles and scatter; these are stated only without one. Scatter at edges
        and fixed patterns are stated where nothing else differs, a ripple where nothing else is clearer. Noise that
        repeats is stated where neither all light differs nor what all cubes have in common.
        """
        others = any(row.different for row in self.pools if row.kind not in (*CANCELLING, "numbers"))
        kinds = [k for k in CANCELLING if {row.kind for row in self.deciding}.isdisjoint(HIDDEN_BY.get(k, ()))]
        rows = {kind: row for kind in kinds for row in reversed(self.of_kind(kind)) if row.different}
        if "texture" in rows and rows["texture"].name != FIXED_TEXTURE and others:
            del rows["texture"]
        if "dark" in rows:
            return f"{rows['dark'].pixels} {rows['dark'].name}"
        if "wave" in rows and rows["wave"] is not self.deciding[0]:
            del rows["wave"]
        for kind in ("grid", "wave", "steps", "tile", "lines", "line", "reused", "shared", "fixed", "texture"):
            if kind in rows:
                share_of = "its fine structure's variance" if kind in ("reused", "shared") else "the light"
                return f"{rows[kind].name}, {abs(rows[kind].difference):.2g} of {share_of}"
        return None

    @property
    def is_pattern(self) -> bool:
        """Whether nothing differs but a pattern whose means cancel, away from edges."""
        edges = [row for row in self.of_kind("texture") if row.name != FIXED_TEXTURE]
        deciding = [row for row in self.deciding if row.kind != "numbers"]
        others = [row for row in deciding if row.kind not in CANCELLING or row in edges]
        return bool(deciding) and (not others or (self._grid and set(others) <= set(edges)))

    @property
    def _grid(self) -> bool:
        """Whether a periodic pattern decides, which scatters pixels at edges, too."""
        return any(row.different for row in self.of_kind("grid"))

    def of_kind(self, kind: str) -> tuple[PooledMean, ...]:
        """Tests of one kind of pool.

        Parameters
        ----------
        kind
            As in ``PooledMean.kind``.

        Returns
        -------
        tuple of PooledMean
            The tests.
        """
        return tuple(row for row in self.pools if row.kind == kind)

    @property
    def deciding(self) -> tuple[PooledMean, ...]:
        """Tests that make the verdict "different", the clearest first."""
        rows = [row for row in self.pools if row.different]
        return tuple(sorted(rows, key=lambda row: row.probability / row.critical))

    def lines(self) -> list[str]:
        """Verdict and named change in sentences.

        Returns
        -------
        list of str
            The verdict first.
        """
        mean = self.picture_mean
        size = as_percent(mean.difference, "the baseline", unit="%")
        word, is_known = "SAME" if self.same else "DIFFERENT", math.isfinite(mean.sigma)
        text = [f"{word}: mean light {size} ± {mean.sigma:.3%}" if is_known else word]
        text += [f"{absent.sentence(side)}." for side, absent in self.not_numbers.items()]
        if self.same:
            text.append(f"With 95 % confidence, the mean light differs by less than {self.equivalence_95:.3%}.")
        if is_known:
            text.append(f"An even change of the light by {self.would_have_seen:.3%} is detected in 90 of 100 runs.")
        where = "" if self.spot is None else self.spot.sentence
        pattern = f"Pattern whose means cancel: {self.cancelling}." if self.cancelling else ""
        text += [sentence for sentence in (self.unseen, self.of_noise, self.of_numbers, where, pattern) if sentence]
        for index, change in enumerate(self.changes[:_MOST_NAMES]):
            start = "Cause" if change.change == UNKNOWN else "Named" if change.fits else "Most like"
            start = start if index == 0 else f"or {start[0].lower()}{start[1:]}"
            text.append(f"{start}: {change_text(change)}, probability {change.probability:.2f}")
        if self.fits is not None and math.isfinite(self.left_chi2_per_number):
            chi2, fit = self.left_chi2_per_number, "it fits" if self.fits else "it does not fit"
            text.append(f"The best name leaves a χ² per number of {chi2:.2f} (noise: about 1): {fit}.")
        if self.outliers:
            text.append(
                f"• {self.outliers} outlying pixels (fireflies) are not included in the means; they contain "
                f"{self.outlier_share:+.3%} of the light"
            )
        return [*text, *(f"• {note}" for note in self.notes), *(_OF_COLUMNS if self.tables() else ())]

    def tables(self) -> list[Table]:
        """Surfaces, and the pools that decided.

        Returns
        -------
        list of Table
            Tables with rows.
        """
        numbers = ("difference, %", "± %", "sigmas", "detectable, %")
        surfaces = tuple((row.name, *_cells(row)) for row in self.of_kind("surface"))
        decided = tuple(
            (row.label + (f" ({row.unit})" if row.unit != "1" else ""), *_cells(row))
            for row in [row for row in self.deciding if row.kind != "numbers"][:_MOST_ROWS]
        )
        tables = (
            Table("Surfaces", ("surface", *numbers), surfaces),
            Table("What decided", ("test", *numbers), decided),
        )
        return [table for table in tables if table.rows]

    def to_dict(self) -> dict[str, Any]:
        """Content of the JSON file.

        Returns
        -------
        dict
            Finite numbers; None in place of others.
        """
        mean = self.picture_mean
        record = {
            "same": self.same,
            "mean_relative_difference": mean.difference,
            "sigma": mean.sigma,
            "equivalence_95": self.equivalence_95,
            "would_have_seen": self.would_have_seen,
            "would_have_seen_in_parts": self.would_have_seen_in_parts,
            "named": [
                {"change": n.change, "parameters": n.parameters, "probability": n.probability} for n in self.changes
            ],
            "left_chi2_per_number": self.left_chi2_per_number,
            "fits": self.fits,
            "surfaces": {row.name: _record(row) for row in self.of_kind("surface")},
            "bands": {row.name: _record(row) for row in self.of_kind("band")},
            "strata": {row.name: _record(row) for row in self.of_kind("stratum")},
            "patterns": {
                row.name: {**_record(row), "unit": row.unit}
                for kind in ("pattern", *CANCELLING, *STRUCTURE)
                for row in self.of_kind(kind)
            },
            "stored": dict(zip(("baseline", "candidate"), self.numbers, strict=True)) if self.of_numbers else None,
            "noise_not_visible": self.of_noise or None,
            "layers": {row.name: _record(row) for row in self.of_kind("layer")},
            "not_numbers": {side: absent.record() for side, absent in self.not_numbers.items()},
            "cancelling": self.cancelling,
            "where": None if self.spot is None else self.spot.record(),
            "even": {row.name: _record(row) for row in self.of_kind("even")},
            "blocks": {row.name: _record(row) for kind in (*GRIDS, "cubes") for row in self.of_kind(kind)},
            "spread": {row.name: _record(row) for row in self.of_kind("spread")},
            "order": {row.name: _record(row) for kind in ("order", "place") for row in self.of_kind(kind)},
            "deciding": [f"{row.kind}: {row.name}" for row in self.deciding],
            "false_alarm_rate": self.false_alarms,
            "outliers": {"pixels": self.outliers, "relative_light": self.outlier_share},
            "pixels_differing": self.pixels_differing,
            "baseline": self.baseline,
            "candidate": self.candidate,
            "notes": list(self.notes),
        }
        return {key: json_value(value) for key, value in record.items()}


def _cells(row: PooledMean) -> tuple[str, ...]:
    """Numbers of a test as text."""
    percent = 100.0 if row.unit == "1" else 1.0
    size = as_percent(row.difference, "it", ".3g") if row.unit == "1" else f"{row.difference:.3g}"
    return (size, *(f"{value:.3g}" for value in (percent * row.sigma, row.statistic, percent * row.detectable)))


def _record(row: PooledMean) -> dict[str, Any]:
    """Figures of one test."""
    return {
        "relative_difference": row.difference,
        "sigma": row.sigma,
        "probability": row.probability,
        "critical_probability": row.critical,
        "would_have_seen": row.detectable,
        "pixels": row.pixels,
        "different": row.different,
    }


def as_percent(difference: float, of: str, form: str = "+.3f", unit: str = "") -> str:
    """Relative difference as text.

    Parameters
    ----------
    difference
        Difference over the reference.
    of
        Name of the reference.
    form
        Format of the percentage.
    unit
        Text after the percentage.

    Returns
    -------
    str
        The percentage, or, where less than a thousandth of the light remains, the remaining part.
    """
    remaining = 1 + difference
    return f"{remaining:.3g} of {of}" if 0 < remaining < _LITTLE_LIGHT else f"{100 * difference:{form}}{unit}"


def change_text(change: NamedChange) -> str:
    """Change and parameters as text.

    Parameters
    ----------
    change
        The change.

    Returns
    -------
    str
        Identifier, and the parameters in brackets; of an unknown cause its description.
    """
    if change.change == UNKNOWN and set(change.parameters) == {"description"}:
        return f"{UNKNOWN}, {change.parameters['description']}"
    values = ", ".join(f"{key} {_written(value, 4)}" for key, value in change.parameters.items())
    return f"{change.change} ({values})" if values else change.change


def name_line(outcome: Outcome) -> str:
    """Name of the change in words: "named" where it fits, otherwise "most like".

    Parameters
    ----------
    outcome
        Outcome of two different pictures, with explanations.

    Returns
    -------
    str
        The words; empty without explanations.
    """
    if not outcome.changes:
        return ""
    first, name = outcome.changes[0], outcome.best_name
    if first.fits and first.change != UNKNOWN:
        return f"named {change_text(first)}"
    if name is None:
        return f"cause {change_text(first)}"
    cause = f"cause {change_text(first)}, " if first.change == UNKNOWN else ""
    remainder = "" if name.fits else f", which leaves {name.chi2:.2g} times the noise"
    return f"{cause}most like {change_text(name)}{remainder}"


def _written(value: Any, digits: int) -> str:
    """Parameter as text, numbers with some digits."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_written(item, 5)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_written(item, 5) for item in value) + "]"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def write_junit(path: Path, outcome: Outcome) -> None:
    """Write a JUnit file: one test case for each pool, and one for all blocks.

    A case fails where its pool decides.

    Parameters
    ----------
    path
        The file; an existing one is replaced.
    outcome
        The outcome.
    """
    rows = [row for row in outcome.pools if row.kind not in GRIDS]
    blocks = [row for kind in GRIDS for row in outcome.of_kind(kind) if row.different]
    failures = sum(row.different for row in rows) + bool(blocks)
    suite = ET.Element("testsuite", name="cbox regress", tests=str(len(rows) + 1), failures=str(failures), errors="0")
    for row in rows:
        _case(suite, f"{row.kind}: {row.name}", [row] if row.different else [])
    _case(suite, "blocks", blocks)
    ET.SubElement(suite, "system-out").text = "\n".join([summary(outcome), *outcome.notes])
    with replacing(path) as temporary:
        ET.ElementTree(suite).write(temporary, encoding="utf-8", xml_declaration=True)


def _case(suite: ET.Element, name: str, failing: list[PooledMean]) -> None:
    """Append a test case with its failures."""
    case = ET.SubElement(suite, "testcase", classname="cbox.regress", name=name)
    for row in failing:
        ET.SubElement(case, "failure", message=_pool_text(row))


def github_lines(outcome: Outcome) -> list[str]:
    """Workflow commands of GitHub Actions, shown next to a pull request.

    Parameters
    ----------
    outcome
        The outcome.

    Returns
    -------
    list of str
        A notice where the pictures are the same, and a warning where their numbers are stored differently; otherwise an
        error for the verdict and for the clearest pools.
    """
    file = Path(outcome.candidate)
    location = f"file={_escaped(outcome.candidate)},line=1," if file.is_file() else ""
    if outcome.same:
        lines = {"notice": summary(outcome), "warning": outcome.of_numbers}
        return [f"::{kind} {location}title=cbox regress::{_escaped(text)}" for kind, text in lines.items() if text]
    return [f"::error {location}title=cbox regress::{_escaped(summary(outcome))}"] + [
        f"::error {location}title=cbox regress::{_escaped(_pool_text(row))}"
        for row in outcome.deciding[:_MAX_GITHUB_POOLS]
    ]


def summary(outcome: Outcome) -> str:
    """Verdict in one line.

    Parameters
    ----------
    outcome
        The outcome.

    Returns
    -------
    str
        The line.
    """
    mean = outcome.picture_mean
    if outcome.same:
        return (
            f"same: mean light agrees within {outcome.equivalence_95:.3%} at 95 %; "
            f"{outcome.would_have_seen:.3%} would have been seen"
            + (f". {outcome.unseen}" if outcome.single_pictures else "")
        )
    facts = [absent.sentence(side) for side, absent in outcome.not_numbers.items()]
    if math.isfinite(mean.sigma):
        facts.insert(0, f"mean light {as_percent(mean.difference, 'the baseline', unit='%')} +- {mean.sigma:.3%}")
    return f"different: {', '.join(filter(None, [*facts, name_line(outcome)]))}"


def _pool_text(row: PooledMean) -> str:
    """One test in a line."""
    if row.kind == "numbers":
        return row.label
    unit = "" if row.unit == "1" else f" {row.unit}"
    return f"{row.label}: {row.difference:+.4g}{unit} +- {row.sigma:.2g}, {abs(row.statistic):.1f} sigma"


def _escaped(text: str) -> str:
    """Text of a workflow command."""
    return text.replace("%", "%25").replace("\n", "%0A")
