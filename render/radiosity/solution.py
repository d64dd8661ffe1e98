"""Interreflection between patches: form factors by ray tracing, and the radiosity solution at every wavelength.

All radiances are relative to a lamp's, L(lambda). The outgoing radiance of a Lambertian patch of reflectance rho is
b = rho (e + F b): e is its direct irradiance over pi, F_ij the fraction of the (cosine-weighted) hemisphere of i
covered by j (Goral et al. 1984). Rows of F sum to 1 minus the fraction that leaves through the opening.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..device import SobolPoints, cosine_hemisphere, dr, mi
from ..visibility import RAY_OFFSET_MM, Tracer, intersect
from .lamp import LampSampler, direct_light
from .patch_slopes import PatchSlopes, build_slopes
from .patches import Patches, patch_of, patch_points

__all__ = ["Exchange", "indirect_basis", "solve", "trace_exchange"]


#: Relative accuracy of the radiosity solution, which contributes about a quarter of a picture's light.
TOLERANCE = 1e-5

#: Relative residual of ``solve``, a few times the rounding of its single precision.
_ACCURACY = 1e-6

#: Steps after which ``solve`` stops; boxes that lose next to no light would take more.
_MOST_STEPS = 200

#: A patch passes on no more than 1 of its light; single precision sums it to a few parts in a million.
_ENERGY = 1e-3

#: The reduced basis begins with so many bounces at so many wavelengths, and is extended so often at most.
_SNAPSHOTS, _BOUNCES, _MOST_EXTENSIONS = 7, 4, 12


@dataclass(frozen=True, eq=False)
class Exchange:
    """Light exchange between patches.

    direct : (p, lamps) e by each lamp. form_factors : (p, p) F, for patches whose radiance varies linearly with
    ``slopes`` (a few entries are negative). escape : (p,) fraction of the hemisphere that leaves the box.
    exposed : (p,) part of the patch that no other object covers.
    """

    direct: NDArray[np.float32]
    form_factors: NDArray[np.float32]
    escape: NDArray[np.float32]
    slopes: PatchSlopes
    exposed: NDArray[np.float32]


def trace_exchange(tracer: Tracer, lamps: Sequence[LampSampler], patches: Patches, samples: int, seed: int) -> Exchange:
    """Trace ``samples`` cosine-distributed rays and as many samples of every lamp from every patch.

    Points covered by an object see only back sides; they are left out of the means over a patch. A result that breaks
    the conservation of energy is traced once more, with a RuntimeWarning that tells what differs: a disturbed machine
    has made such ones, one in some hundreds of processes, which the same command then did not repeat. Raises
    ArithmeticError the second time.
    """
    exchange, seen = _traced(tracer, lamps, patches, samples, seed)
    fault = _energy_fault(exchange, seen)
    if fault is None:
        return exchange
    again, seen_again = _traced(tracer, lamps, patches, samples, seed)
    differences = _differences((exchange, seen), (again, seen_again))
    warnings.warn(f"{fault}; traced once more, it differs in {differences}", RuntimeWarning, stacklevel=2)
    fault = _energy_fault(again, seen_again)
    if fault is not None:
        lost = np.count_nonzero(~np.isfinite(patches.centre).all(axis=1) | ~(patches.area > 0))
        raise ArithmeticError(f"{fault}; {lost} patches have no place or no area")
    return again


def _traced(
    tracer: Tracer, lamps: Sequence[LampSampler], patches: Patches, samples: int, seed: int
) -> tuple[Exchange, NDArray[np.float32]]:
    """The exchange, and (p,) how many points of each patch are not covered."""
    count = len(patches)
    slopes = build_slopes(tracer, patches)
    lane = dr.arange(mi.UInt32, count)
    points = SobolPoints(6, samples, lane, seed)
    matrix = dr.zeros(mi.Float, count * count)
    on_patch_at = patch_points(tracer, patches)

    def body(
        i: mi.UInt32, direct: list[mi.Float], escaped: mi.Float, seen: mi.Float
    ) -> tuple[mi.UInt32, list[mi.Float], mi.Float, mi.Float]:
        position, normal = on_patch_at(lane, points.point(i, 0), points.point(i, 1))
        u, v = points.point(i, 2), points.point(i, 3)
        light = [direct_light(tracer, lamp, position, normal, u, v, mi.Bool(True)) for lamp in lamps]
        direction = cosine_hemisphere(normal, points.point(i, 4), points.point(i, 5))
        hit = intersect(tracer, mi.Ray3f(position + normal * RAY_OFFSET_MM, direction))
        exposed = ~hit.valid | hit.front
        on_patch = hit.reflecting
        target = patch_of(patches, hit.triangle, hit.uv, on_patch)
        for patch, weight in slopes.weights(target, hit.position, on_patch):
            # other modes leave out weights that are not numbers, which hides a disturbed exchange
            dr.scatter_add(matrix, weight, lane * count + patch, on_patch, mode=dr.ReduceMode.Direct)
        return (
            i + 1,
            [old + dr.select(exposed, new, 0) for old, new in zip(direct, light, strict=True)],
            escaped + dr.select(hit.valid, mi.Float(0), mi.Float(1)),
            seen + dr.select(exposed, mi.Float(1), mi.Float(0)),
        )

    total = dr.opaque(mi.UInt32, samples)
    zeros = [dr.zeros(mi.Float, count) for _ in (*lamps, "escaped", "seen")]
    start = (dr.zeros(mi.UInt32, count), zeros[:-2], *zeros[-2:])
    _, direct, escaped, seen = dr.while_loop(start, lambda i, *_: i < total, body)
    dr.eval(direct, escaped, seen, matrix)
    points_seen = np.array(seen)
    scale = 1 / np.maximum(points_seen, 1)
    form_factors = np.array(matrix).reshape(count, count)
    form_factors *= scale[:, None]
    matrix = dr.zeros(mi.Float, 0)  # gives the traced numbers back
    dr.flush_malloc_cache()
    exchange = Exchange(
        direct=np.stack([np.array(own) * scale for own in direct], axis=1),
        form_factors=form_factors,
        escape=np.array(escaped) * scale,
        slopes=slopes,
        exposed=(points_seen / samples).astype(np.float32),
    )
    return exchange, points_seen


def _energy_fault(exchange: Exchange, seen: NDArray) -> str | None:
    """A sentence where patches pass on more light than they get, less than none, or saw nothing at all, else None."""
    passed_on = exchange.form_factors.sum(axis=1) + exchange.escape
    least, most, direct = passed_on.min(), passed_on.max(), exchange.direct.max()
    if seen.max() > 0 and least > -_ENERGY and most < 1 + _ENERGY and np.isfinite(direct):
        return None
    unknown = ~np.isfinite(exchange.form_factors)
    return (
        f"the light exchange between {len(seen)} patches breaks the conservation of energy: they pass on {least:g} "
        f"to {most:g} of their light, direct light up to {direct:g}, {np.count_nonzero(unknown)} form factors are "
        f"not finite, of {unknown.any(axis=1).sum()} patches towards {unknown.any(axis=0).sum()}"
    )


def _differences(first: tuple[Exchange, NDArray], again: tuple[Exchange, NDArray]) -> str:
    """What of two exchanges, which should be the same to the bit, is not: how many numbers, where, a sample's bits.

    Whole rows come from one lane or one thread's share of lanes, single columns from a patch's slopes, neighbours in
    memory from elsewhere. A NaN of arithmetic has the bits ffc00000, others were never a number.
    """
    told = []
    for name, of in {
        "form factors": lambda e, _: e.form_factors,
        "direct light": lambda e, _: e.direct,
        "escape": lambda e, _: e.escape,
        "points seen": lambda _, seen: seen,
        "slopes": lambda e, _: e.slopes.across.astype(np.float32),
        "centres": lambda e, _: e.slopes.centre.astype(np.float32),
        "neighbours": lambda e, _: e.slopes.neighbour.astype(np.uint32),
    }.items():
        one, other = (np.ascontiguousarray(of(*each)).view(np.uint32) for each in (first, again))
        places = np.argwhere(one != other)
        if len(places):
            low, high = places.min(axis=0).tolist(), places.max(axis=0).tolist()
            bits = one[tuple(places[0])]
            told.append(f"{len(places)} {name} between {low} and {high} (first bits {bits:08x})")
    return "; ".join(told) or "nothing"


def solve(
    exchange: Exchange,
    reflectance: NDArray,
    source: NDArray | None = None,
    max_reflections: int | None = None,
) -> NDArray[np.float64]:
    """Outgoing radiance b (p, w) of every patch: the sum over reflections, or the solution of b = rho (e + F b).

    reflectance : (p, w). source : (p, w) or (p, 1) first irradiance over pi; default that of all lamps, each of
    radiance 1.
    max_reflections : number of reflections summed (None: all, to a relative residual of 1e-6).
    """
    first = exchange.direct.sum(axis=1, keepdims=True) if source is None else source
    start = np.asarray(reflectance * first, float)
    rho = reflectance.astype(np.float32)

    def reflected(light: NDArray) -> NDArray:
        return rho * (exchange.form_factors @ light.astype(np.float32))

    if max_reflections is not None:
        bounce = total = start
        for _ in range(max_reflections - 1):
            bounce = reflected(bounce)
            total = total + bounce
        return total
    return _converged(start, reflected)


def _converged(source: NDArray, reflected: Callable[[NDArray], NDArray]) -> NDArray[np.float64]:
    """The solution b = source + reflected(b) of every column (p, w) by itself, to a relative residual of _ACCURACY.

    Generalised conjugate residuals: each step takes the residual as a direction and makes its image orthogonal to those
    of all directions before (Eisenstat, Elman and Schultz 1983). It takes a third of the matrix products of a sum over
    reflections.
    """
    total, residual = np.zeros_like(source), source
    directions: list[tuple[NDArray, NDArray, NDArray]] = []
    enough = _ACCURACY**2 * np.sum(source**2, axis=0)
    for _ in range(_MOST_STEPS):
        open_columns = np.sum(residual**2, axis=0) > enough
        if not open_columns.any():
            break
        way, image = residual, residual - reflected(residual)
        for before, its_image, size in directions:
            part = np.sum(image * its_image, axis=0) / size
            way, image = way - part * before, image - part * its_image
        size = np.maximum(np.sum(image**2, axis=0), 1e-300)
        directions.append((way, image, size))
        step = np.where(open_columns, np.sum(residual * image, axis=0) / size, 0.0)
        total, residual = total + step * way, residual - step * image
    return total


def indirect_basis(
    exchange: Exchange,
    lamp: int,
    material: NDArray,
    reflectances: NDArray,
    max_reflections: int | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The patches' indirectly lit radiance rho F b under one lamp at all wavelengths, as a short sum of products.

    material : (p,) of each patch. reflectances : (material, w). Returns coefficients (p, k) and spectra
    (k, w) with coefficients @ spectra = rho F b. What the sum leaves out is below TOLERANCE of the largest product: a
    few 1e-5 of the light, up to 2e-4 of the brightest patch's at single wavelengths.

    After many reflections the spatial distribution of light is similar at all wavelengths. So b is computed by a
    Galerkin method in a reduced basis of the first few bounces at a few wavelengths, which is extended by what is left
    of b = rho (e + F b) until that holds at every wavelength.
    """
    direct = exchange.direct[:, lamp, None]
    if not (direct * reflectances[material]).any():
        return np.zeros((len(material), 1)), np.zeros((1, reflectances.shape[1]))
    if max_reflections is None:
        shapes, amplitudes = _reduced_solution(exchange.form_factors, direct, material, reflectances)
    else:
        rho = reflectances[material]
        b = solve(exchange, rho, direct, max_reflections)
        shapes, amplitudes = b / np.maximum(rho, 1e-12) - direct, np.eye(b.shape[1])
    factors, spectra = [], []
    for index, reflectance in enumerate(reflectances):
        q, r = np.linalg.qr(shapes[material == index])
        factors.append(q)
        spectra.append((r @ amplitudes) * reflectance)
    left, singular, right = np.linalg.svd(np.concatenate(spectra), full_matrices=False)
    rank = max(1, int(np.sum(singular > TOLERANCE * singular[0])))
    mixed = np.split(left[:, :rank] * singular[:rank], np.cumsum([len(x) for x in spectra])[:-1])
    coefficients = np.empty((len(material), rank))
    for index, (q, mix) in enumerate(zip(factors, mixed, strict=True)):
        coefficients[material == index] = q @ mix
    return coefficients, right[:rank]


def _reduced_solution(
    form_factors: NDArray, direct: NDArray, material: NDArray, reflectances: NDArray
) -> tuple[NDArray, NDArray]:
    """F times the basis (p, n), and the amplitudes (n, w) of b in it."""
    rho = reflectances[material]
    chosen = np.unique(np.linspace(0, rho.shape[1] - 1, _SNAPSHOTS).astype(int))
    bounces = [(rho[:, chosen] * direct).astype(np.float32)]
    for _ in range(_BOUNCES):
        bounces.append((rho[:, chosen] * (form_factors @ bounces[-1])).astype(np.float32))
    space = _orthonormal(np.hstack(bounces).astype(np.float64))
    transported = form_factors @ space.astype(np.float32)
    for _ in range(_MOST_EXTENSIONS):
        amplitudes, left, relative = _galerkin(space, transported, material, reflectances, direct)
        unsolved = relative > TOLERANCE
        if not unsolved.any():
            break
        left = left[:, unsolved] / np.linalg.norm(left[:, unsolved], axis=0)
        more = _orthonormal(left - space @ (space.T @ left))
        space = np.hstack([space, more])
        transported = np.hstack([transported, form_factors @ more.astype(np.float32)])
    return transported[:, : len(amplitudes)], amplitudes


def _orthonormal(columns: NDArray) -> NDArray:
    """(p, n) what spans columns, without combinations below a millionth of the largest."""
    singular, vectors = np.linalg.eigh(columns.T @ columns)
    kept = np.sqrt(np.maximum(singular, 0)) > 1e-6 * np.sqrt(max(singular[-1], 0))
    return np.linalg.qr(columns @ vectors[:, kept])[0]


def _galerkin(
    space: NDArray, transported: NDArray, material: NDArray, reflectances: NDArray, direct: NDArray
) -> tuple[NDArray, NDArray, NDArray]:
    """Amplitudes (n, w) of b = rho (e + F b) in the span of ``space``, what is left of it (p, w), and the norm of that
    over the norm of b (w,)."""
    masks = [material == m for m in range(len(reflectances))]
    operators = np.stack([space[mask].T @ transported[mask] for mask in masks])
    sources = np.stack([space[mask].T @ direct[mask, 0] for mask in masks])
    system = np.eye(space.shape[1]) - np.einsum("mw,mij->wij", reflectances, operators)
    amplitudes = np.linalg.solve(system, (reflectances.T @ sources)[..., None])[..., 0].T
    b = space @ amplitudes
    left = reflectances[material] * (direct + transported @ amplitudes) - b
    return amplitudes, left, np.linalg.norm(left, axis=0) / np.maximum(np.linalg.norm(b, axis=0), 1e-300)
