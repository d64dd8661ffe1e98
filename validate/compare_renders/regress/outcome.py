"""The outcome of a regression: verdict, statistics, thresholds and tables; as JUnit XML, and as lines that GitHub shows
beside a pull request."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.files import replacing
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import NDArray
from scipy.stats import t

from .pooled import PooledMean

__all__ = ["NamedChange", "Outcome", "as_percent", "github_lines", "summary", "told_change", "write_junit"]

#: What is left of the light from which down a difference is told as a part of it, not in per cent.
_LITTLE = 1e-3


@dataclass(frozen=True)
class NamedChange(OwnMappings):
    """One explanation. change : its identifier. probability : among all that were tried. chi2 : per number."""

    change: str
    parameters: Mapping[str, Any]
    probability: float
    chi2: float = float("nan")


@dataclass(frozen=True, eq=False)
class Outcome(OwnMappings):
    """Whether two pictures show the same light.

    pools : all pooled tests. false_alarms : the verdict's rate of false alarms. outliers, outlier_share :
    pixels set aside as fireflies and the light in them, relative. pixels_differing : pixels that differ by
    themselves (false discovery rate 1 %); they do not enter the verdict. relative : (y, x)
    difference over the baseline, summed over wavelengths.
    """

    baseline: str
    candidate: str
    pools: tuple[PooledMean, ...]
    false_alarms: float
    outliers: int
    outlier_share: float
    pixels_differing: int
    relative: NDArray[np.float64]
    named: tuple[NamedChange, ...] = ()
    notes: tuple[str, ...] = ()
    kinds: Mapping[str, str] = field(default_factory=dict)

    @property
    def same(self) -> bool:
        """True where no pool tells the pictures apart."""
        return not any(row.different for row in self.pools)

    @property
    def whole(self) -> PooledMean:
        """The mean over the picture, the lamp left out."""
        return self.pools[0]

    @property
    def would_have_seen(self) -> float:
        """Size of an even change of the light, relative, found in 90 of 100 runs like this."""
        return min(row.detectable for row in (self.whole, *self.of_kind("even")))

    @property
    def equivalence_95(self) -> float:
        """The mean light agrees within this, relative, at 95 %."""
        whole = self.whole
        return abs(whole.difference) + float(t.isf(0.05, whole.degrees)) * whole.sigma

    def of_kind(self, kind: str) -> tuple[PooledMean, ...]:
        """The pools of one kind."""
        return tuple(row for row in self.pools if row.kind == kind)

    @property
    def deciding(self) -> tuple[PooledMean, ...]:
        """The pools that make the verdict "different", the clearest first."""
        rows = [row for row in self.pools if row.different]
        return tuple(sorted(rows, key=lambda row: row.probability / row.critical))

    def to_dict(self) -> dict[str, Any]:
        """What ``--json`` writes; only finite numbers, None for others."""
        whole = self.whole
        record = {
            "same": self.same,
            "mean_relative_difference": whole.difference,
            "sigma": whole.sigma,
            "equivalence_95": self.equivalence_95,
            "would_have_seen": self.would_have_seen,
            "named": [
                {"change": n.change, "parameters": n.parameters, "probability": n.probability} for n in self.named
            ],
            "surfaces": {row.name: _record(row) for row in self.of_kind("surface")},
            "bands": {row.name: _record(row) for row in self.of_kind("band")},
            "strata": {row.name: _record(row) for row in self.of_kind("stratum")},
            "patterns": {row.name: {**_record(row), "unit": row.unit} for row in self.of_kind("pattern")},
            "even": {row.name: _record(row) for row in self.of_kind("even")},
            "blocks": {row.name: _record(row) for row in self.of_kind("block")},
            "deciding": [f"{row.kind}: {row.name}" for row in self.deciding],
            "false_alarm_rate": self.false_alarms,
            "outliers": {"pixels": self.outliers, "relative_light": self.outlier_share},
            "pixels_differing": self.pixels_differing,
            "baseline": self.baseline,
            "candidate": self.candidate,
            "notes": list(self.notes),
        }
        return {key: _finite(value) for key, value in record.items()}


def _record(row: PooledMean) -> dict[str, Any]:
    return {
        "relative_difference": row.difference,
        "sigma": row.sigma,
        "probability": row.probability,
        "critical_probability": row.critical,
        "would_have_seen": row.detectable,
        "pixels": row.pixels,
        "different": row.different,
    }


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def as_percent(difference: float, of: str, form: str = "+.3f", unit: str = "") -> str:
    """A relative difference in per cent; where less than a thousandth is left, as a part of what it is compared with.

    of : what that is called.
    """
    left = 1 + difference
    return f"{left:.3g} of {of}" if 0 < left < _LITTLE else f"{100 * difference:{form}}{unit}"


def told_change(named: NamedChange) -> str:
    """The change and its parameters, as text."""
    values = ", ".join(f"{key} {_written(value, 4)}" for key, value in named.parameters.items())
    return f"{named.change} ({values})" if values else named.change


def _written(value: Any, digits: int) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_written(item, 5)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_written(item, 5) for item in value) + "]"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def write_junit(path: Path, outcome: Outcome) -> None:
    """One test case for each pool but the blocks, which share one; a case fails where its pool decides."""
    rows = [row for row in outcome.pools if row.kind != "block"]
    blocks = [row for row in outcome.of_kind("block") if row.different]
    failures = sum(row.different for row in rows) + bool(blocks)
    suite = ET.Element("testsuite", name="cbox regress", tests=str(len(rows) + 1), failures=str(failures), errors="0")
    for row in rows:
        _case(suite, f"{row.kind}: {row.name}", [row] if row.different else [])
    _case(suite, "blocks", blocks)
    ET.SubElement(suite, "system-out").text = "\n".join([summary(outcome), *outcome.notes])
    with replacing(path) as temporary:
        ET.ElementTree(suite).write(temporary, encoding="utf-8", xml_declaration=True)


def _case(suite: ET.Element, name: str, failing: list[PooledMean]) -> None:
    case = ET.SubElement(suite, "testcase", classname="cbox.regress", name=name)
    for row in failing:
        ET.SubElement(case, "failure", message=_told(row))


def github_lines(outcome: Outcome) -> list[str]:
    """Workflow commands of GitHub Actions: an error where the pictures differ, a notice where not."""
    if outcome.same:
        return [f"::notice title=cbox regress::{_escaped(summary(outcome))}"]
    return [f"::error title=cbox regress::{_escaped(summary(outcome))}"] + [
        f"::error title=cbox regress::{_escaped(_told(row))}" for row in outcome.deciding[:3]
    ]


def summary(outcome: Outcome) -> str:
    """The verdict in one line."""
    whole = outcome.whole
    if outcome.same:
        return (
            f"same: mean light agrees within {outcome.equivalence_95:.3%} at 95 %; "
            f"{outcome.would_have_seen:.3%} would have been seen"
        )
    named = f", named {told_change(outcome.named[0])}" if outcome.named else ""
    return f"different: mean light {as_percent(whole.difference, 'the baseline', unit='%')} +- {whole.sigma:.3%}{named}"


def _told(row: PooledMean) -> str:
    unit = "" if row.unit == "1" else f" {row.unit}"
    return f"{row.kind} {row.name}: {row.difference:+.4g}{unit} +- {row.sigma:.2g}, {abs(row.statistic):.1f} sigma"


def _escaped(text: str) -> str:
    return text.replace("%", "%25").replace("\n", "%0A")
