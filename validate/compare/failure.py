"""Where the model fails: a short ranked list of regions, bands and kinds of light with most of the excess chi2."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.rendering.image import LightShares
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import NDArray

from .comparison import Comparison
from .regions import INTERIOR_DISTANCE_PX

__all__ = ["OUTSIDE", "SIGNIFICANT", "Failure", "Part", "parts", "ranked_failures"]

#: What the camera sees beside the box, a region of its own.
OUTSIDE = "outside the box"

#: Below this probability an excess counts as more than noise.
SIGNIFICANT = 1e-3

#: Light is called direct above the first share of direct light, indirect below the second.
_MOSTLY, _HARDLY = 0.65, 0.35
#: Smallest share of light reflected by a material for which the material is named.
_NOTABLE = 0.15

#: Largest number of entries, and smallest share of the excess of each.
_MOST_ENTRIES, _LEAST_SHARE = 3, 0.1


@dataclass(frozen=True, eq=False)
class Part:
    """A subset of the residuals. kind : the property that defines it. words : in words. where : (band, y, x)."""

    kind: str
    words: str
    where: NDArray[np.bool_]


@dataclass(frozen=True)
class Failure(OwnMappings):
    """An entry of the list. words : where it is. share_of_excess, share_of_residuals : 0 to 1; the first can exceed 1
    if the excess of other residuals is negative. chi2_per_residual : 1 is expected. kinds : words by kind of part.
    """

    words: str
    share_of_excess: float
    share_of_residuals: float
    chi2_per_residual: float
    kinds: Mapping[str, str]

    @property
    def sentence(self) -> str:
        """The entry as a sentence."""
        return (
            f"{100 * self.share_of_excess:.0f} % of the excess χ² is {self.words}, "
            f"with {100 * self.share_of_residuals:.0f} % of the residuals "
            f"(mean χ² per residual {self.chi2_per_residual:.3g})."
        )


def parts(
    c: Comparison, material: Mapping[str, str], band_nm: Sequence[float], shares: LightShares | None
) -> list[Part]:
    """The subsets of the residuals that are considered.

    material : name by surface. band_nm : (band,) centres of the bands, nm. shares : None if not known.
    """
    maps = c.maps
    shape = maps["residual_over_sigma"].shape
    names = tuple(c.by_surface)
    index, distance = maps["surface"].values, maps["edge_distance_px"].values

    def everywhere(where: NDArray) -> NDArray[np.bool_]:
        return np.broadcast_to(where, shape)

    found = [Part("surface", f"on {_the(name)}", everywhere(index == i)) for i, name in enumerate(names)]
    for group in dict.fromkeys(material.values()):
        own = [i for i, name in enumerate(names) if material.get(name) == group]
        if len(own) > 1:
            found.append(Part("surface", f"on {group} surfaces", everywhere(np.isin(index, own))))
    found.append(Part("surface", OUTSIDE, everywhere(index < 0)))
    found.append(Part("edge distance", "in interiors", everywhere(distance >= INTERIOR_DISTANCE_PX)))
    near = (distance < INTERIOR_DISTANCE_PX) & (index >= 0)
    found.append(Part("edge distance", f"within {INTERIOR_DISTANCE_PX:g} px of edges", everywhere(near)))
    v, u = np.indices(shape[1:])
    radius = np.hypot(v - (shape[1] - 1) / 2, u - (shape[2] - 1) / 2)
    outer = radius > 0.5 * radius.max()
    found.append(Part("image radius", "in the middle of the picture", everywhere(~outer)))
    found.append(Part("image radius", "in the outer half of the picture", everywhere(outer)))
    found += _band_parts(c.bands, np.asarray(band_nm, float), shape)
    if shares is not None:
        found.append(Part("light", "where most light is direct", shares.direct > _MOSTLY))
        found.append(Part("light", "where light is direct and reflected", abs(shares.direct - 0.5) <= _MOSTLY - 0.5))
        found.append(Part("light", "where light is indirect", shares.direct < _HARDLY))
        found += [
            Part("paint before", f"where light was reflected by {name} before", share > _NOTABLE)
            for name, share in zip(dict.fromkeys(material.values()), shares.via_material, strict=False)
        ]
    return found


def _the(surface: str) -> str:
    return f"the {surface.replace('-', ' ')}" + (" wall" if surface in ("left", "right", "back") else "")


def _band_parts(bands: Sequence[str], nm: NDArray, shape: tuple[int, ...]) -> list[Part]:
    order = np.argsort(nm)
    found = []
    for count in range(1, len(bands)):
        border = (nm[order[count - 1]] + nm[order[count]]) / 2
        for words, own in (
            (f"below {border:.0f} nm", order[:count]),
            (f"above {border:.0f} nm", order[count:]),
        ):
            if len(own) > 1:
                where = np.zeros(shape, bool)
                where[own] = True
                found.append(Part("band", words, where))
    for i, band in enumerate(bands):
        where = np.zeros(shape, bool)
        where[i] = True
        found.append(Part("band", f"in band {band}", where))
    return found


def ranked_failures(c: Comparison, known: Sequence[Part]) -> tuple[Failure, ...]:
    """The few groups of residuals with most of the excess chi2 in the fewest residuals; empty if noise explains all.

    A group is the intersection of parts of different kinds. Parts are added one by one while the score
    s log(s / r) grows, with s the share of excess and r the share of residuals. The next group is searched in the
    remaining residuals.
    """
    z = c.maps["residual_over_sigma"].values
    used = np.isfinite(z)
    if c.chi2.p_value >= SIGNIFICANT or not used.any():
        return ()
    excess = np.where(used, np.nan_to_num(z) ** 2 - 1, 0.0)
    total, count = float(excess.sum()), int(used.sum())
    left, found = used.copy(), []
    for _ in range(_MOST_ENTRIES):
        here, chosen = _densest(excess, left, known, total, count)
        share = float(excess[here].sum()) / total
        if not chosen or share < _LEAST_SHARE:
            break
        inside = int(here.sum())
        found.append(
            Failure(
                " ".join(part.words for part in chosen),
                share,
                inside / count,
                float(excess[here].sum()) / inside + 1,
                {part.kind: part.words for part in chosen},
            )
        )
        left &= ~here
    return tuple(found)


_ORDER = ("edge distance", "image radius", "surface", "light", "paint before", "band")


def _densest(
    excess: NDArray, left: NDArray, known: Sequence[Part], total: float, count: int
) -> tuple[NDArray[np.bool_], list[Part]]:
    here, best = left, 0.0
    chosen: list[Part] = []
    while True:
        candidates = [p for p in known if p.kind not in {q.kind for q in chosen}]
        scored = [(_score(excess, here & p.where, total, count), i) for i, p in enumerate(candidates)]
        # of two parts with the same score the first is used: it is the more specific
        score, index = max(scored, key=lambda item: (item[0], -item[1]), default=(0.0, 0))
        # a further condition must increase the score by at least 10%
        if score <= 1.1 * best or score <= 0:
            break
        best, here = score, here & candidates[index].where
        chosen.append(candidates[index])
    return here, sorted(chosen, key=lambda part: _ORDER.index(part.kind))


def _score(excess: NDArray, where: NDArray, total: float, count: int) -> float:
    share, size = float(excess[where].sum()) / total, int(where.sum()) / count
    return share * np.log(share / size) if share > 0 and size > 0 else 0.0
