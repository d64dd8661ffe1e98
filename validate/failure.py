"""Where the model fails: the excess chi2 by surface, band, place and light, as a short ranked list in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.render.light_shares import LightShares
from numpy.typing import NDArray

from .blocks import ReportSection, Table, number
from .compare import Comparison
from .regions import INTERIOR_DISTANCE_PX

__all__ = ["Failure", "Part", "failure_section", "parts", "ranked_failures"]

#: Below this probability an excess counts as more than noise.
_SIGNIFICANT = 1e-3

#: From this share on direct light is most of it, below the other little of it.
_MOSTLY, _HARDLY = 0.65, 0.35
#: Light by way of a paint is worth naming from this share on.
_NOTABLE = 0.15

#: A list no longer than this, each entry with at least this share of the excess.
_MOST_ENTRIES, _LEAST_SHARE = 3, 0.1


@dataclass(frozen=True, eq=False)
class Part:
    """Some residuals. kind : what tells them apart from others. where : (band, y, x)."""

    kind: str
    words: str
    where: NDArray[np.bool_]


@dataclass(frozen=True)
class Failure:
    """An entry of the list. words : where it is. share_of_excess, share_of_residuals : 0 to 1; the first may exceed 1
    where other residuals fall short of noise. chi2_per_residual : 1 is expected. kinds : by kind, in words."""

    words: str
    share_of_excess: float
    share_of_residuals: float
    chi2_per_residual: float
    kinds: Mapping[str, str]

    @property
    def sentence(self) -> str:
        """As a person would say it."""
        return (
            f"{100 * self.share_of_excess:.0f} % of the excess sits {self.words}, "
            f"with {100 * self.share_of_residuals:.0f} % of the residuals (χ² {self.chi2_per_residual:.3g} each)."
        )


def parts(
    c: Comparison, material: Mapping[str, str], band_nm: Sequence[float], shares: LightShares | None
) -> list[Part]:
    """Everything by which residuals are told apart. material : of each surface. band_nm : centres of the bands."""
    maps = c.maps
    shape = maps["residual_over_sigma"].shape
    names = tuple(c.by_surface)
    index, distance = maps["surface"].values, maps["edge_distance_px"].values

    def everywhere(where: NDArray) -> NDArray[np.bool_]:
        return np.broadcast_to(where, shape)

    found = [Part("surface", f"on {_the(name)}", everywhere(index == i)) for i, name in enumerate(names)]
    for paint in dict.fromkeys(material.values()):
        own = [i for i, name in enumerate(names) if material.get(name) == paint]
        if len(own) > 1:
            found.append(Part("surface", f"on {paint} surfaces", everywhere(np.isin(index, own))))
    found.append(Part("edge distance", "in the interior", everywhere(distance >= INTERIOR_DISTANCE_PX)))
    found.append(
        Part(
            "edge distance",
            f"within {INTERIOR_DISTANCE_PX:g} px of edges",
            everywhere(distance < INTERIOR_DISTANCE_PX),
        )
    )
    v, u = np.indices(shape[1:])
    radius = np.hypot(v - (shape[1] - 1) / 2, u - (shape[2] - 1) / 2)
    outer = radius > 0.5 * radius.max()
    found.append(Part("image radius", "in the picture's middle", everywhere(~outer)))
    found.append(Part("image radius", "in the picture's outer half", everywhere(outer)))
    found += _band_parts(c.bands, np.asarray(band_nm, float), shape)
    if shares is not None:
        found.append(Part("light", "where most light is direct", shares.direct > _MOSTLY))
        found.append(
            Part("light", "where light is direct and reflected", abs(shares.direct - 0.5) <= _MOSTLY - 0.5)
        )
        found.append(Part("light", "where light is indirect", shares.direct < _HARDLY))
        paints = dict.fromkeys(material.values())
        found += [
            Part("paint before", f"where light comes by way of {paint}", way > _NOTABLE)
            for paint, way in zip(paints, shares.by_way_of, strict=False)
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
    """The few groups of residuals that hold most of the excess in the least room; none where noise explains all.

    A group is cut out by one part of a kind after another as long as log-ratio of its shares of excess and of
    residuals, weighted by the former, grows; the next is sought in what is left.
    """
    z = c.maps["residual_over_sigma"].values
    used = np.isfinite(z)
    if c.chi2.p_value >= _SIGNIFICANT or not used.any():
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
                " ".join(part.words for part in chosen), share, inside / count,
                float(excess[here].sum()) / inside + 1, {part.kind: part.words for part in chosen},
            )
        )  # fmt: skip
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
        # of two parts that cut out the same the first is the more particular one
        score, index = max(scored, key=lambda item: (item[0], -item[1]), default=(0.0, 0))
        # one more condition has to earn its words
        if score <= 1.1 * best or score <= 0:
            break
        best, here = score, here & candidates[index].where
        chosen.append(candidates[index])
    return here, sorted(chosen, key=lambda part: _ORDER.index(part.kind))


def _score(excess: NDArray, where: NDArray, total: float, count: int) -> float:
    share, size = float(excess[where].sum()) / total, int(where.sum()) / count
    return share * np.log(share / size) if share > 0 and size > 0 else 0.0


def failure_section(c: Comparison, known: Sequence[Part], failures: Sequence[Failure]) -> ReportSection:
    """The list, and the excess by each kind of part."""
    z = c.maps["residual_over_sigma"].values
    used = np.isfinite(z)
    excess = np.where(used, np.nan_to_num(z) ** 2 - 1, 0.0)
    total = max(float(excess.sum()), 1e-9)
    rows = []
    for part in known:
        here = part.where & used
        if not here.any() or (part.kind == "band" and not part.words.startswith("in ")):
            continue
        share = float(excess[here].sum())
        rows.append(
            (part.words, part.kind, number(100 * here.sum() / used.sum(), 0), number(100 * share / total, 0),
             number(1 + share / here.sum(), 3))
        )  # fmt: skip
    told = [f.sentence for f in failures] or ["Noise explains what is there: there is nothing to tell apart."]
    table = Table(
        ("where", "told apart by", "residuals, %", "excess χ², %", "χ² each"), rows,
        "Light is direct where it met nothing between the lamp and what is seen; shares are the forward model's own.",
    )  # fmt: skip
    return ReportSection("Where the model fails", told, (table,))
