"""Test of one pool, and the shares of false alarms by kind."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cboxlab.utils.distributions import normal_quantile, student_quantile

from ...scene_pictures import LayerChange, NotNumbers
from .difference import Finding

__all__ = [
    "CANCELLING",
    "GRIDS",
    "HIDDEN_BY",
    "MEANS",
    "POWER",
    "SHARES",
    "STRUCTURE",
    "PooledMean",
    "certain_layers",
    "certain_numbers",
    "pool_of_finding",
    "unknown_mean",
]

#: Parts of the false-alarm rate by kind of pool, with sum 1: most for the sharpest tests of common changes.
SHARES = {
    "whole": 0.09,
    "even": 0.163,
    "surface": 0.155,
    "band": 0.09,
    "stratum": 0.05,
    "pattern": 0.08,
    "block": 0.04,
    "colour": 0.02,
    "cubes": 0.02,
    "spread": 0.01,
    "grid": 0.01,
    "line": 0.005,
    "lines": 0.005,
    "fixed": 0.005,
    "tile": 0.01,
    "steps": 0.01,
    "texture": 0.009,
    "dark": 0.001,
    "cut": 0.005,
    "order": 0.01,
    "wave": 0.01,
    "place": 0.01,
    "slow": 0.05,
    "contrast": 0.03,
    "displacement": 0.05,
    "reused": 0.005,
    "shared": 0.005,
    "filter": 0.011,
    "part": 0.02,
    "motion": 0.02,
    "layer": 0.0005,
    "numbers": 0.0005,
}

#: Kinds of pools that find what means do not show.
CANCELLING = ("grid", "wave", "line", "lines", "fixed", "tile", "steps", "texture", "dark", "cut", "reused", "shared")

_OTHERS = tuple(kind for kind in SHARES if kind not in (*CANCELLING, "numbers"))
#: Kinds of pools that no repeated noise changes: light of the whole picture, and what all cubes have in common.
_NO_NOISE = ("whole", "even", "band", "fixed")
#: Kinds of pools by the kind of a pattern that is not stated where one of them decides.
HIDDEN_BY = {"lines": _OTHERS, "fixed": _OTHERS, "reused": _NO_NOISE, "shared": _NO_NOISE}

#: Kinds of pools that need no known noise: slow changes, contrast and place of fine structure, small parts.
STRUCTURE = ("slow", "contrast", "displacement", "filter", "part", "motion")

#: Kinds of pools that are means over pixels.
MEANS = ("whole", "even", "surface", "band", "stratum", "block", "colour", "cubes", "spread")

#: Kinds of pools of a grid of blocks.
GRIDS = ("block", "colour")

#: Part of all runs in which a difference of the stated detectable size is found.
POWER = 0.9
#: Probability of a fact without noise, such as a layer that differs, over its critical one.
_CERTAIN = 1e-6
#: Smallest relative standard deviation of a pattern: double precision.
_LEAST_SIGMA = 1e-12


@dataclass(frozen=True)
class PooledMean:
    """Test of one pool."""

    #: One of ``SHARES``.
    kind: str
    #: Name among its kind.
    name: str
    #: Number of pixels.
    pixels: int
    #: Difference of the means over the baseline's mean; for patterns a size in ``unit``.
    difference: float
    #: Standard deviation of ``difference``.
    sigma: float
    #: Degrees of freedom of ``sigma``.
    degrees: float
    #: ``difference`` over ``sigma``.
    statistic: float
    #: Probability, two-sided, of a statistic this large in equal pictures.
    probability: float
    #: Probability below which this pool alone makes the verdict "different".
    critical: float
    #: Size of a difference that is found in 90 of 100 runs like this.
    detectable: float
    #: Unit of ``difference``.
    unit: str = "1"
    #: First column and row of the place that it tests, and one after the last ones; None for all of the picture.
    bounds_px: tuple[int, int, int, int] | None = None

    @property
    def label(self) -> str:
        """Kind and name in words.

        Examples
        --------
        >>> from dataclasses import replace
        >>> row = PooledMean("band", "550", 9, 0.1, 0.2, 1.0, 0.5, 0.6, 0.01, 0.4)
        >>> row.label, replace(row, kind="whole", name="whole picture").label
        ('band 550 nm', 'whole picture')
        """
        kind = {"whole": "", "even": "all pixels ", "numbers": ""}.get(self.kind, f"{self.kind} ")
        return f"{kind}{self.name}" + (" nm" if self.kind == "band" and self.name.isdecimal() else "")

    @property
    def different(self) -> bool:
        """Whether this pool alone decides."""
        return self.probability < self.critical


def pool_of_finding(kind: str, finding: Finding, critical: float) -> PooledMean:
    """Test of a finding.

    Parameters
    ----------
    kind
        Kind of the pattern, one of ``CANCELLING``.
    finding
        The finding.
    critical
        Probability below which it decides.

    Returns
    -------
    PooledMean
        The test.
    """
    sigma = max(finding.sigma, _LEAST_SIGMA)
    threshold = float(student_quantile(critical / 2 / finding.looks, finding.degrees))
    typical = sigma if finding.typical_sigma is None else finding.typical_sigma
    return PooledMean(
        kind,
        finding.name,
        finding.pixels,
        finding.size,
        sigma,
        finding.degrees,
        finding.size / sigma,
        finding.probability,
        critical,
        (threshold + float(normal_quantile(1.0 - POWER))) * typical,
        finding.unit,
        finding.parameters.get("bounds_px"),
    )


def certain_layers(changes: Sequence[LayerChange], false_alarms: float) -> tuple[PooledMean, ...]:
    """Tests of the files' layers, which have no noise.

    Parameters
    ----------
    changes
        Part of the pixels in which each layer differs.
    false_alarms
        Rate of false alarms of the verdict.

    Returns
    -------
    tuple of PooledMean
        One for each layer.
    """
    critical = false_alarms * SHARES["layer"]
    findings = [
        Finding(c.name, c.pixels, c.part, max(c.part, 1e-12) / 10, 12.0, _CERTAIN * critical if c.part else 1.0)
        for c in changes
    ]
    return tuple(pool_of_finding("layer", finding, critical) for finding in findings)


def certain_numbers(absent: Mapping[str, NotNumbers], false_alarms: float) -> tuple[PooledMean, ...]:
    """Tests of pixels that are not numbers on one side, which no noise explains.

    Parameters
    ----------
    absent
        The pixels by the side's name.
    false_alarms
        Rate of false alarms of the verdict.

    Returns
    -------
    tuple of PooledMean
        One for each side that has such pixels.
    """
    critical, rows = false_alarms * SHARES["numbers"], []
    for side, alone in absent.items():
        part = float(alone.pixels.mean())
        finding = Finding(alone.sentence(side), int(alone.pixels.sum()), part, part / 10, 12.0, _CERTAIN * critical)
        rows.append(pool_of_finding("numbers", finding, critical))
    return tuple(rows)


def unknown_mean() -> PooledMean:
    """Mean of a picture of too few pixels that are numbers on both sides.

    Returns
    -------
    PooledMean
        A difference of NaN, which does not decide.
    """
    return PooledMean("whole", "whole picture", 0, math.nan, math.inf, 1.0, 0.0, 1.0, 0.0, math.inf)
