"""The outcome of a regression: one immutable object with verdict, statistics, thresholds and tables."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from cboxlab.scenes.frozen import OwnMappings
from numpy.typing import NDArray
from scipy.stats import t

from .pooled import PooledMean

__all__ = ["NamedChange", "Outcome"]


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
                {"change": n.change, "parameters": n.parameters, "probability": n.probability}
                for n in self.named
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
        "relative_difference": row.difference, "sigma": row.sigma, "probability": row.probability,
        "critical_probability": row.critical, "would_have_seen": row.detectable, "pixels": row.pixels,
        "different": row.different,
    }  # fmt: skip


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
