"""Ranked list of the regions, bands and kinds of light with most of the excess chi2."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from cboxlab.rendering.image import LightShares
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from .comparison import Comparison
from .regions import INTERIOR_DISTANCE_PX

__all__ = ["OUTSIDE", "SIGNIFICANT", "Failure", "Part", "parts", "ranked_failures"]

#: Region of the pixels that do not see the box.
OUTSIDE = "outside the box"

#: Probability below which an excess counts as more than noise.
SIGNIFICANT = 1e-3

#: Share of direct light above which light is called direct.
_MIN_DIRECT_SHARE = 0.65

#: Share of direct light below which light is called indirect.
_MAX_INDIRECT_SHARE = 0.35

#: Smallest share of light reflected by a material for which the material is named.
_MIN_MATERIAL_SHARE = 0.15

#: Largest number of entries of the list.
_MAX_ENTRIES = 3

#: Smallest share of the excess of an entry.
_MIN_SHARE = 0.1

#: Smallest ratio of the score with a further condition to the score without it.
_MIN_SCORE_RATIO = 1.1

#: Kinds of parts in the order in which a sentence names them.
_KIND_ORDER = ("edge distance", "image radius", "surface", "light", "paint before", "band")


@dataclass(frozen=True, eq=False)
class Part:
    """A subset of the residuals."""

    #: Property that defines it, such as "surface" or "light".
    kind: str
    #: Description that continues "the excess is ...".
    label: str
    #: (band, y, x) True for its residuals.
    where: NDArray[np.bool_]


@dataclass(frozen=True)
class Failure(FrozenMappings):
    """An entry of the list."""

    #: Description of the group of residuals, which continues "the excess is ...".
    label: str
    #: Share of the excess; above 1 if the excess of other residuals is negative.
    share_of_excess: float
    #: Share of the residuals, 0 to 1.
    share_of_residuals: float
    #: Mean chi2 per residual; noise alone gives 1.
    chi2_per_residual: float
    #: Description by kind of part.
    kinds: Mapping[str, str]

    @property
    def record(self) -> dict[str, Any]:
        """The entry of ``failures`` in metrics.json."""
        return {
            "words": self.label,
            "share_of_excess": self.share_of_excess,
            "share_of_residuals": self.share_of_residuals,
            "chi2_per_residual": self.chi2_per_residual,
            "kinds": dict(self.kinds),
        }

    @property
    def sentence(self) -> str:
        """The entry as a sentence."""
        return (
            f"Mean χ² per residual {self.chi2_per_residual:.3g} {self.label}: "
            f"{100 * self.share_of_excess:.0f} % of the excess χ² with {100 * self.share_of_residuals:.0f} % of the "
            "residuals."
        )


def parts(
    c: Comparison, material: Mapping[str, str], band_nm: Sequence[float], shares: LightShares | None
) -> list[Part]:
    """Subsets of the residuals that the list may name.

    Parameters
    ----------
    c
        The comparison.
    material
        Name of the material by surface.
    band_nm
        (band,) centres of the bands, nm.
    shares
        Shares of direct light and of light by material; None if not known.

    Returns
    -------
    list
        The subsets, which overlap.
    """
    maps = c.maps
    shape = maps["residual_over_sigma"].shape
    names = tuple(c.by_surface)
    index, distance = maps["surface"].values, maps["edge_distance_px"].values

    def everywhere(where: NDArray) -> NDArray[np.bool_]:
        return np.broadcast_to(where, shape)

    subsets = [Part("surface", f"on {_the(name)}", everywhere(index == i)) for i, name in enumerate(names)]
    for group in dict.fromkeys(material.values()):
        members = [i for i, name in enumerate(names) if material.get(name) == group]
        if len(members) > 1:
            subsets.append(Part("surface", f"on {group} surfaces", everywhere(np.isin(index, members))))
    subsets.append(Part("surface", OUTSIDE, everywhere(index < 0)))
    subsets.append(Part("edge distance", "in interiors", everywhere(distance >= INTERIOR_DISTANCE_PX)))
    near = (distance < INTERIOR_DISTANCE_PX) & (index >= 0)
    subsets.append(Part("edge distance", f"within {INTERIOR_DISTANCE_PX:g} px of edges", everywhere(near)))
    v, u = np.indices(shape[1:])
    radius = np.hypot(v - (shape[1] - 1) / 2, u - (shape[2] - 1) / 2)
    outer = radius > 0.5 * radius.max()
    subsets.append(Part("image radius", "in the middle of the picture", everywhere(~outer)))
    subsets.append(Part("image radius", "in the outer half of the picture", everywhere(outer)))
    subsets += _band_parts(c.bands, np.asarray(band_nm, float), shape)
    if shares is not None:
        subsets.append(Part("light", "where most light is direct", shares.direct > _MIN_DIRECT_SHARE))
        mixed = abs(shares.direct - 0.5) <= _MIN_DIRECT_SHARE - 0.5
        subsets.append(Part("light", "where light is direct and reflected", mixed))
        subsets.append(Part("light", "where light is indirect", shares.direct < _MAX_INDIRECT_SHARE))
        subsets += [
            Part("paint before", f"where light was reflected by {name} before", share > _MIN_MATERIAL_SHARE)
            for name, share in zip(dict.fromkeys(material.values()), shares.via_material, strict=False)
        ]
    return subsets


def _the(surface: str) -> str:
    """Name of a surface in a sentence."""
    return f"the {surface.replace('-', ' ')}" + (" wall" if surface in ("left", "right", "back") else "")


def _band_parts(bands: Sequence[str], nm: NDArray, shape: tuple[int, ...]) -> list[Part]:
    """Bands below and above each border between two of them, and single bands."""
    order = np.argsort(nm)
    subsets = []
    for count in range(1, len(bands)):
        border = (nm[order[count - 1]] + nm[order[count]]) / 2
        for label, members in (
            (f"below {border:.0f} nm", order[:count]),
            (f"above {border:.0f} nm", order[count:]),
        ):
            if len(members) > 1:
                where = np.zeros(shape, bool)
                where[members] = True
                subsets.append(Part("band", label, where))
    for i, band in enumerate(bands):
        where = np.zeros(shape, bool)
        where[i] = True
        subsets.append(Part("band", f"in band {band}", where))
    return subsets


def ranked_failures(c: Comparison, candidates: Sequence[Part]) -> tuple[Failure, ...]:
    """Groups of few residuals with much of the excess chi2.

    A group is the intersection of parts of different kinds. Parts are added one by one while the score
    s log(s / r) grows, with s the share of excess and r the share of residuals. The next group is searched in the
    remaining residuals.

    Parameters
    ----------
    c
        The comparison.
    candidates
        Subsets of the residuals, see ``parts``.

    Returns
    -------
    tuple
        At most three groups, that of the largest mean chi2 per residual first; empty if noise explains the difference.
    """
    z = c.maps["residual_over_sigma"].values
    used = np.isfinite(z)
    if c.chi2.p_value >= SIGNIFICANT or not used.any():
        return ()
    excess = np.where(used, np.nan_to_num(z) ** 2 - 1, 0.0)
    total, count = float(excess.sum()), int(used.sum())
    remaining, groups = used.copy(), []
    for _ in range(_MAX_ENTRIES):
        members, conditions = _densest(excess, remaining, candidates, total, count)
        share = float(excess[members].sum()) / total
        if not conditions or share < _MIN_SHARE:
            break
        inside = int(members.sum())
        groups.append(
            Failure(
                " ".join(part.label for part in conditions),
                share,
                inside / count,
                float(excess[members].sum()) / inside + 1,
                {part.kind: part.label for part in conditions},
            )
        )
        remaining &= ~members
    return tuple(sorted(groups, key=lambda group: -group.chi2_per_residual))


def _densest(
    excess: NDArray, remaining: NDArray, candidates: Sequence[Part], total: float, count: int
) -> tuple[NDArray[np.bool_], list[Part]]:
    """Group with the highest score among the remaining residuals, and the parts that define it."""
    members, best = remaining, 0.0
    conditions: list[Part] = []
    while True:
        further = [p for p in candidates if p.kind not in {q.kind for q in conditions}]
        scored = [(_score(excess, members & p.where, total, count), i) for i, p in enumerate(further)]
        # of two parts with the same score the first is used: it is the more specific
        score, index = max(scored, key=lambda item: (item[0], -item[1]), default=(0.0, 0))
        if score <= _MIN_SCORE_RATIO * best or score <= 0:
            break
        best, members = score, members & further[index].where
        conditions.append(further[index])
    return members, sorted(conditions, key=lambda part: _KIND_ORDER.index(part.kind))


def _score(excess: NDArray, where: NDArray, total: float, count: int) -> float:
    """Score s log(s / r) of a group; 0 without excess or residuals."""
    share, size = float(excess[where].sum()) / total, int(where.sum()) / count
    return share * np.log(share / size) if share > 0 and size > 0 else 0.0
