"""Interreflection between patches: form factors by tracing rays, and the solution at every wavelength.

Notation: everything is relative to the lamp's radiance L(lambda). A Lambertian patch of reflectance rho
sends out radiance b = rho (e + F b): e is its direct irradiance over pi, F_ij the fraction of the
hemisphere of i that sees j (Goral et al. 1984; F row-stochastic up to what leaves by the opening).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from .lamp import LampSampler, direct_light
from .patches import Patches, patch_of, patch_points
from .sampling import SobolPoints, cosine_hemisphere
from .tracer import RAY_OFFSET_MM, Tracer, intersect

__all__ = ["Exchange", "indirect_basis", "solve", "trace_exchange"]


@dataclass(frozen=True, eq=False)
class Exchange:
    """What patches see. direct : (p,) e above. form_factors : (p, p) F. escape : (p,) fraction that leaves the box."""

    direct: NDArray[np.float32]
    form_factors: NDArray[np.float32]
    escape: NDArray[np.float32]


def trace_exchange(tracer: Tracer, lamp: LampSampler, patches: Patches, samples: int, seed: int) -> Exchange:
    """Trace ``samples`` cosine-distributed rays and as many lamp samples from every patch.

    Points that something stands on see only backs; they are left out of their patch's means.
    """
    count = len(patches)
    lane = dr.arange(mi.UInt32, count)
    points = SobolPoints(6, samples, lane, seed)
    matrix = dr.zeros(mi.Float, count * count)
    parent = mi.UInt32(patches.triangle.astype(np.uint32))
    normal = dr.gather(mi.Vector3f, tracer.packed_normals, parent)
    corners = mi.Float(patches.corners.astype(np.float32).ravel())

    n_surfaces = len(tracer.scene.surfaces)

    def body(
        i: mi.UInt32, direct: mi.Float, escaped: mi.Float, seen: mi.Float
    ) -> tuple[mi.UInt32, mi.Float, mi.Float, mi.Float]:
        position = patch_points(corners, lane, points.point(i, 0), points.point(i, 1))
        light = direct_light(
            tracer, lamp, position, normal, points.point(i, 2), points.point(i, 3), mi.Bool(True)
        )
        direction = cosine_hemisphere(normal, points.point(i, 4), points.point(i, 5))
        hit = intersect(tracer, mi.Ray3f(position + normal * RAY_OFFSET_MM, direction))
        exposed = ~hit.valid | hit.front
        surface = dr.gather(mi.UInt32, tracer.packed_surface, hit.triangle, hit.front)
        on_patch = hit.front & (surface < n_surfaces)
        target = patch_of(patches, hit.triangle, hit.uv, on_patch)
        dr.scatter_add(matrix, mi.Float(1), lane * count + target, on_patch)
        return (
            i + 1,
            direct + dr.select(exposed, light, 0),
            escaped + dr.select(hit.valid, mi.Float(0), mi.Float(1)),
            seen + dr.select(exposed, mi.Float(1), mi.Float(0)),
        )

    total = dr.opaque(mi.UInt32, samples)
    start = (dr.zeros(mi.UInt32, count), *(dr.zeros(mi.Float, count) for _ in range(3)))
    _, direct, escaped, seen = dr.while_loop(start, lambda i, *_: i < total, body)
    dr.eval(direct, escaped, seen, matrix)
    scale = 1 / np.maximum(np.array(seen), 1)
    return Exchange(
        direct=np.array(direct) * scale,
        form_factors=np.array(matrix).reshape(count, count) * scale[:, None],
        escape=np.array(escaped) * scale,
    )


def solve(
    exchange: Exchange,
    reflectance: NDArray,
    source: NDArray | None = None,
    max_reflections: int | None = None,
) -> NDArray[np.float64]:
    """Outgoing radiance b (p, w) of every patch by bounce after bounce until nothing is left.

    reflectance : (p, w). source : (p, w) or (p, 1) first irradiance over pi, the lamp's ``direct`` where None.
    max_reflections : stop after so many reflections (None: to convergence, relative 1e-7).
    """
    first = exchange.direct[:, None] if source is None else source
    bounce = (reflectance * first).astype(np.float32)
    total = bounce.astype(np.float64)
    limit = 1000 if max_reflections is None else max_reflections - 1
    rho = reflectance.astype(np.float32)
    for _ in range(limit):
        bounce = rho * (exchange.form_factors @ bounce)
        total += bounce
        if bounce.max() < 1e-7 * total.max():
            break
    return total


def indirect_basis(
    exchange: Exchange,
    patches: Patches,
    reflectances: NDArray,
    max_reflections: int | None = None,
    tolerance: float = 3e-6,
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """The patches' indirectly lit radiance rho F b at all wavelengths, as a short sum of products.

    reflectances : (material, w). Returns coefficients (p, k) and spectra (k, w) with
    coefficients @ spectra = b - rho e within ``tolerance`` of its largest value.

    b is solved at a few wavelengths only, chosen by greed: at all others it is found in the space that
    these span (a reduced basis), and the wavelength whose equation is left worst is solved next.
    """
    wavelengths = reflectances.shape[1]
    rho = reflectances[patches.material]
    direct = exchange.direct.astype(np.float64)
    transported = np.empty((len(patches), 0))
    space = np.empty((len(patches), 0))
    b = np.zeros((len(patches), wavelengths))
    chosen: list[int] = []
    worst = int(np.argmax(reflectances.sum(axis=0)))
    for _ in range(min(24, wavelengths)):
        chosen.append(worst)
        snapshot = solve(exchange, rho[:, [worst]], max_reflections=max_reflections)
        fresh = snapshot - space @ (space.T @ snapshot)
        fresh -= space @ (space.T @ fresh)
        norm = np.linalg.norm(fresh)
        if norm < 1e-6 * np.linalg.norm(snapshot):
            break
        space = np.hstack([space, fresh / norm])
        transported = np.hstack([transported, exchange.form_factors @ (fresh / norm)])
        b, residual = _in_space(space, transported, rho, direct)
        worst = int(np.argmax(residual))
        if residual[worst] < tolerance or worst in chosen:
            break
    indirect = rho * (transported @ (space.T @ b))
    u, s, vt = np.linalg.svd(indirect, full_matrices=False)
    rank = max(1, int(np.sum(s > tolerance * s[0])))
    return (u[:, :rank] * s[:rank]).astype(np.float32), vt[:rank]


def _in_space(space: NDArray, transported: NDArray, rho: NDArray, direct: NDArray) -> tuple[NDArray, NDArray]:
    """Galerkin solution of b = rho (e + F b) in the span of ``space``, and its relative residual per wavelength."""
    b = np.empty_like(rho)
    residual = np.empty(rho.shape[1])
    for w in range(rho.shape[1]):
        source = rho[:, w] * direct
        operator = np.eye(space.shape[1]) - space.T @ (rho[:, w, None] * transported)
        y = np.linalg.solve(operator, space.T @ source)
        b[:, w] = space @ y
        residual[w] = np.linalg.norm(b[:, w] - source - rho[:, w] * (transported @ y)) / np.linalg.norm(
            b[:, w]
        )
    return b, residual
