"""Shadow rays that pass boundaries without refraction, and the media behind them."""

from __future__ import annotations

from dataclasses import dataclass

from ..device import dr, mi
from ..materials import SpectralMedia
from ..visibility import RAY_OFFSET_MM, Tracer, intersect

__all__ = ["Shadow", "shadow_through"]

#: The part of a shadow ray's length that is its end.
_END = 1e-4

#: A shadow ray that passes so many boundaries counts as blocked.
_MOST_BOUNDARIES = 256


@dataclass(frozen=True, eq=False)
class Shadow:
    """A shadow ray: free if it meets nothing opaque; the boundaries that it passes; its transmittance by wavelength."""

    free: mi.Bool
    boundaries: mi.UInt32
    transmittance: list[mi.Float]


def shadow_through(
    tracer: Tracer,
    media: SpectralMedia,
    passing: mi.UInt32,
    which: mi.UInt32,
    origin: mi.Point3f,
    target: mi.Point3f,
    *,
    bands: int,
    active: mi.Bool,
) -> Shadow:
    """The shadow ray from ``origin``, in medium ``which``, to ``target``.

    passing : by material, 1 for boundaries that light passes without a change of direction.
    """

    def body(
        on: mi.Bool, free: mi.Bool, count: mi.UInt32, place: mi.Point3f, medium: mi.UInt32, parts: list[mi.Float]
    ) -> tuple:
        way = target - place
        length = dr.norm(way)
        direction = way / length
        hit = intersect(tracer, mi.Ray3f(place, direction), on)
        short = hit.valid & (hit.distance < length * (1 - _END))
        through = short & (dr.gather(mi.UInt32, passing, hit.material, short) == 1)
        passed = media.transmittance(medium, dr.select(short, hit.distance, length))
        parts = [dr.select(on, old * new, old) for old, new in zip(parts, passed, strict=True)]
        side = dr.select(dr.dot(direction, hit.normal) < 0, mi.Float(-1), mi.Float(1))
        return (
            on & through & (count < _MOST_BOUNDARIES),
            free | (on & ~short),
            count + dr.select(through, mi.UInt32(1), mi.UInt32(0)),
            mi.Point3f(dr.select(through, hit.position + hit.normal * (side * RAY_OFFSET_MM), place)),
            dr.select(through, media.behind(hit, direction, medium, through), medium),
            parts,
        )

    width = dr.width(active)
    state = (
        mi.Bool(active),
        dr.full(mi.Bool, False, width),
        dr.zeros(mi.UInt32, width),
        mi.Point3f(origin),
        mi.UInt32(which),
        [dr.ones(mi.Float, width) for _ in range(bands)],
    )
    _, free, count, _, _, parts = dr.while_loop(state, lambda on, *_: on, body)
    return Shadow(free, count, parts)
