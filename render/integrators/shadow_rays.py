"""Shadow rays that pass boundaries without refraction, and the media behind them."""

from __future__ import annotations

from dataclasses import dataclass

from ..device import dr, mi
from ..materials import SpectralMedia
from ..visibility import RAY_OFFSET_MM, Tracer, intersect

__all__ = ["Shadow", "shadow_through"]

#: Part of a shadow ray's length at its end that is not tested.
_END = 1e-4

#: Largest number of boundaries that a shadow ray passes; with more it counts as blocked.
_MOST_BOUNDARIES = 256


@dataclass(frozen=True, eq=False)
class Shadow:
    """Shadow rays from one point to another."""

    #: Whether the ray meets nothing opaque.
    free: mi.Bool
    #: Number of boundaries that it passes.
    boundaries: mi.UInt32
    #: Transmittance, 0 to 1, at each wavelength, of the media that it passes.
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
    """Shadow rays through boundaries without refraction.

    Parameters
    ----------
    tracer
        Tracer of the scene.
    media
        Media of the scene.
    passing
        By material, 1 for boundaries that light passes without a change of direction.
    which
        Number of the medium at the start.
    origin
        Start of each lane's ray, mm.
    target
        End of each lane's ray, mm.
    bands
        Number of wavelengths.
    active
        Lanes whose rays are traced.

    Returns
    -------
    Shadow
        The shadow rays; in other lanes not free.
    """

    def body(
        tracing: mi.Bool, free: mi.Bool, count: mi.UInt32, start: mi.Point3f, medium: mi.UInt32, parts: list[mi.Float]
    ) -> tuple:
        """The part of the ray up to the next boundary."""
        offset = target - start
        length = dr.norm(offset)
        direction = offset / length
        hit = intersect(tracer, mi.Ray3f(start, direction), tracing)
        short = hit.valid & (hit.distance < length * (1 - _END))
        through = short & (dr.gather(mi.UInt32, passing, hit.material, short) == 1)
        passed = media.transmittance(medium, dr.select(short, hit.distance, length))
        parts = [dr.select(tracing, old * new, old) for old, new in zip(parts, passed, strict=True)]
        side = dr.select(dr.dot(direction, hit.normal) < 0, mi.Float(-1), mi.Float(1))
        return (
            tracing & through & (count < _MOST_BOUNDARIES),
            free | (tracing & ~short),
            count + dr.select(through, mi.UInt32(1), mi.UInt32(0)),
            mi.Point3f(dr.select(through, hit.position + hit.normal * (side * RAY_OFFSET_MM), start)),
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
    _, free, count, _, _, parts = dr.while_loop(state, lambda tracing, *_: tracing, body)
    return Shadow(free, count, parts)
