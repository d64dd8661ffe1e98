"""Interreflection between patches: form factors by ray tracing, and the radiosity solution.

All radiances are relative to a lamp's, L(lambda). The outgoing radiance b of Lambertian patches of reflectance rho
satisfies

    b = rho (e + F b)

Here e is the direct irradiance over pi, and F_ij the fraction of the (cosine-weighted) hemisphere of patch i that patch
j covers (Goral et al. 1984). Rows of F sum to 1 minus the fraction that leaves through the opening. The equation is
solved at every wavelength.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.progress import checkpoint
from numpy.typing import NDArray

from ..device import SobolPoints, cosine_hemisphere, dr, lane_ranges, mi
from ..visibility import RAY_OFFSET_MM, Tracer, intersect
from .lamp import LampSampler, direct_light
from .patch_slopes import PatchSlopes, build_slopes
from .patches import Patches, patch_of, patch_points

__all__ = ["Exchange", "indirect_basis", "solve_exchange", "trace_exchange"]


#: Relative accuracy of the radiosity solution, which contributes about a quarter of a picture's light.
TOLERANCE = 1e-5

#: Relative residual of `solve`, a few times the rounding of its single precision.
_ACCURACY = 1e-6

#: Number of steps after which `solve` stops; boxes that lose next to no light would take more.
_MOST_STEPS = 200

#: Time of a sample of the exchange over that of a gathering ray: it has a ray, and adds to four entries of the matrix.
_COST_OF_SAMPLE = 2

#: Permitted error of the sum of form factors and escape, 1: single precision sums it to a few parts in a million.
_ENERGY = 1e-3

#: Number of wavelengths at which the reduced basis begins.
_SNAPSHOTS = 7
#: Number of bounces at each of them in the reduced basis.
_BOUNCES = 4
#: Largest number of extensions of the reduced basis.
_MOST_EXTENSIONS = 12


@dataclass(frozen=True, eq=False)
class Exchange:
    """Exchange of light between lamps and p patches."""

    #: (p, lamps) direct irradiance over pi of each patch by each lamp of radiance 1.
    direct: NDArray[np.float32]
    #: (p, p) F, for patches whose radiance varies linearly with `slopes`; a few entries are negative.
    form_factors: NDArray[np.float32]
    #: (p,) fraction of the hemisphere that leaves the box.
    escape: NDArray[np.float32]
    #: Linear variation of radiance across patches.
    slopes: PatchSlopes
    #: (p,) part of the patch that no other object covers.
    exposed: NDArray[np.float32]


def trace_exchange(tracer: Tracer, lamps: Sequence[LampSampler], patches: Patches, samples: int, seed: int) -> Exchange:
    """Trace the exchange of light: cosine-distributed rays and lamp samples from every patch.

    Points covered by an object see only back sides; they are left out of the means over a patch. A result that breaks
    the conservation of energy is traced once more, with a RuntimeWarning that states the differences. A disturbed
    machine has made such results, one in some hundreds of processes, which the same command then did not repeat.

    Parameters
    ----------
    tracer
        Tracer of the scene.
    lamps
        Samplers of its lamps.
    patches
        Its patches.
    samples
        Rays, and samples of each lamp, of each patch.
    seed
        Seed of the random numbers.

    Returns
    -------
    Exchange
        The exchange.

    Raises
    ------
    ArithmeticError
        If the second result breaks the conservation of energy, too.
    """
    exchange, points = _traced(tracer, lamps, patches, samples, seed)
    fault = _energy_fault(exchange, points)
    if fault is None:
        return exchange
    again, points_again = _traced(tracer, lamps, patches, samples, seed)
    differences = _differences((exchange, points), (again, points_again))
    warnings.warn(f"{fault}; traced once more, it differs in {differences}", RuntimeWarning, stacklevel=2)
    fault = _energy_fault(again, points_again)
    if fault is not None:
        lost = np.count_nonzero(~np.isfinite(patches.centre).all(axis=1) | ~(patches.area > 0))
        raise ArithmeticError(f"{fault}; {lost} patches have no place or no area")
    return again


def _traced(
    tracer: Tracer, lamps: Sequence[LampSampler], patches: Patches, samples: int, seed: int
) -> tuple[Exchange, NDArray[np.float32]]:
    """The exchange, and (p,) number of points of each patch that are not covered."""
    slopes = build_slopes(tracer, patches)
    matrix = np.empty((len(patches), len(patches)), np.float32)
    parts = []
    for first, end in lane_ranges(len(patches), _COST_OF_SAMPLE * samples * len(lamps)):
        traced = _traced_rows(tracer, lamps, patches, slopes, (first, end), samples, seed)
        matrix[first:end] = traced[0]
        parts.append(traced[1:])
    traced = ()  # gives the traced numbers back
    dr.flush_malloc_cache()
    checkpoint()
    direct, escaped, uncovered = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    scale = 1 / np.maximum(uncovered, 1)
    matrix *= scale[:, None]
    exchange = Exchange(
        direct=direct * scale[:, None],
        form_factors=matrix,
        escape=escaped * scale,
        slopes=slopes,
        exposed=(uncovered / samples).astype(np.float32),
    )
    return exchange, uncovered


def _traced_rows(
    tracer: Tracer,
    lamps: Sequence[LampSampler],
    patches: Patches,
    slopes: PatchSlopes,
    some: tuple[int, int],
    samples: int,
    seed: int,
) -> tuple[NDArray[np.float32], ...]:
    """Sums over the points of some patches.

    They are (n, p) rays, (n, lamps) direct light, (n,) escape and (n,) points seen.
    """
    first, end = some
    count = end - first
    row = dr.arange(mi.UInt32, count)
    lane = row + dr.opaque(mi.UInt32, first)
    points = SobolPoints(6, samples, lane, seed)
    matrix = dr.zeros(mi.Float, count * len(patches))
    patch_count = dr.opaque(mi.UInt32, len(patches))
    on_patch_at = patch_points(tracer, patches)

    def body(
        i: mi.UInt32, direct: list[mi.Float], escaped: mi.Float, uncovered: mi.Float
    ) -> tuple[mi.UInt32, list[mi.Float], mi.Float, mi.Float]:
        """One ray, and one sample of every lamp, from each patch."""
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
            dr.scatter_add(matrix, weight, row * patch_count + patch, on_patch, mode=dr.ReduceMode.Direct)
        return (
            i + 1,
            [old + dr.select(exposed, new, 0) for old, new in zip(direct, light, strict=True)],
            escaped + dr.select(hit.valid, mi.Float(0), mi.Float(1)),
            uncovered + dr.select(exposed, mi.Float(1), mi.Float(0)),
        )

    total = dr.opaque(mi.UInt32, samples)
    zeros = [dr.zeros(mi.Float, count) for _ in (*lamps, "escaped", "seen")]
    start = (dr.zeros(mi.UInt32, count), zeros[:-2], *zeros[-2:])
    _, direct, escaped, uncovered = dr.while_loop(start, lambda i, *_: i < total, body)
    dr.eval(direct, escaped, uncovered, matrix)
    by_lamp = np.stack([np.array(column) for column in direct], axis=1)
    return matrix.numpy().reshape(count, len(patches)), by_lamp, np.array(escaped), np.array(uncovered)


def _energy_fault(exchange: Exchange, points: NDArray) -> str | None:
    """A sentence if patches break the conservation of energy; else None.

    They do if they pass on more light than they get, or less than none, or if no point of any is uncovered.
    """
    passed_on = exchange.form_factors.sum(axis=1) + exchange.escape
    least, most, direct = passed_on.min(), passed_on.max(), exchange.direct.max()
    if points.max() > 0 and least > -_ENERGY and most < 1 + _ENERGY and np.isfinite(direct):
        return None
    invalid = ~np.isfinite(exchange.form_factors)
    return (
        f"the light exchange between {len(points)} patches breaks the conservation of energy: they pass on {least:g} "
        f"to {most:g} of their light, direct light up to {direct:g}, {np.count_nonzero(invalid)} form factors are "
        f"not finite, of {invalid.any(axis=1).sum()} patches towards {invalid.any(axis=0).sum()}"
    )


def _differences(first: tuple[Exchange, NDArray], again: tuple[Exchange, NDArray]) -> str:
    """Differences of two exchanges that should be the same to the bit, in words.

    For each part it states the number of entries, their range, and the bits of the first. Whole rows come from one lane
    or one thread's share of lanes, single columns from a patch's slopes, neighbours in memory from elsewhere. A NaN of
    arithmetic has the bits ffc00000, others were never a number.
    """
    differences = []
    for name, of in {
        "form factors": lambda e, _: e.form_factors,
        "direct light": lambda e, _: e.direct,
        "escape": lambda e, _: e.escape,
        "points seen": lambda _, points: points,
        "slopes": lambda e, _: e.slopes.across.astype(np.float32),
        "centres": lambda e, _: e.slopes.centre.astype(np.float32),
        "neighbours": lambda e, _: e.slopes.neighbour.astype(np.uint32),
    }.items():
        before, after = (np.ascontiguousarray(of(*each)).view(np.uint32) for each in (first, again))
        entries = np.argwhere(before != after)
        if len(entries):
            low, high = entries.min(axis=0).tolist(), entries.max(axis=0).tolist()
            bits = before[tuple(entries[0])]
            differences.append(f"{len(entries)} {name} between {low} and {high} (first bits {bits:08x})")
    return "; ".join(differences) or "nothing"


def solve_exchange(
    exchange: Exchange,
    reflectance: NDArray,
    source: NDArray | None = None,
    max_reflections: int | None = None,
    near: NDArray | None = None,
) -> NDArray[np.float64]:
    """Outgoing radiance b of every patch.

    It is the sum over reflections rho (e + F rho e + ...), or the solution of b = rho (e + F b) by conjugate residuals.

    Parameters
    ----------
    exchange
        Exchange between p patches.
    reflectance
        (p, w) reflectance.
    source
        (p, w) or (p, 1) direct irradiance over pi; None for that of all lamps, each of radiance 1.
    max_reflections
        Number of reflections in the sum; None for all, to a relative residual of 1e-6.
    near
        (p, w) radiance of nearly the same light, which shortens the way to all reflections.

    Returns
    -------
    NDArray
        (p, w) outgoing radiance, relative to the lamps'.
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
    return _converged(start, reflected, near)


def _converged(source: NDArray, reflected: Callable[[NDArray], NDArray], near: NDArray | None) -> NDArray[np.float64]:
    """Solution of b = source + reflected(b), for every column (p, w) separately.

    It begins at ``near``, or at darkness. Generalised conjugate residuals, to a relative residual of _ACCURACY: each
    step takes the residual as a direction and makes its image orthogonal to those of all directions before (Eisenstat,
    Elman and Schultz 1983). It takes a third of the matrix products of a sum over reflections.
    """
    total, residual = np.zeros_like(source), source
    if near is not None:
        total, residual = near, source + reflected(near) - near
    directions: list[tuple[NDArray, NDArray, NDArray]] = []
    enough = _ACCURACY**2 * np.sum(source**2, axis=0)
    for _ in range(_MOST_STEPS):
        checkpoint()
        open_columns = np.sum(residual**2, axis=0) > enough
        if not open_columns.any():
            break
        direction, image = residual, residual - reflected(residual)
        for before, image_before, size in directions:
            share = np.sum(image * image_before, axis=0) / size
            direction, image = direction - share * before, image - share * image_before
        size = np.maximum(np.sum(image**2, axis=0), 1e-300)
        directions.append((direction, image, size))
        step = np.where(open_columns, np.sum(residual * image, axis=0) / size, 0.0)
        total, residual = total + step * direction, residual - step * image
    return total


def indirect_basis(
    exchange: Exchange,
    lamp: int,
    shares: NDArray,
    reflectances: NDArray,
    max_reflections: int | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Indirect radiance of the patches under one lamp, as a short sum of products.

    It is rho F b, the light that other patches reflect to a patch and that it reflects once more. After many
    reflections the spatial distribution of light is similar at all wavelengths. So b is computed by a Galerkin method
    in a reduced basis. This begins with the first few bounces at a few wavelengths, and is extended by the residual of
    b = rho (e + F b) until that is small at every wavelength. A singular value decomposition then finds the shortest
    sum.

    What the sum leaves out is below TOLERANCE of the largest product: a few 1e-5 of the light, up to 2e-4 of the
    brightest patch's at single wavelengths.

    Parameters
    ----------
    exchange
        Exchange between p patches.
    lamp
        Index of the lamp.
    shares
        (p, material) share of each material in each patch: 1 for that of a plain one.
    reflectances
        (material, w) reflectances.
    max_reflections
        Number of reflections in b; None for all.

    Returns
    -------
    tuple[NDArray, NDArray]
        Coefficients (p, k) and spectra (k, w); coefficients @ spectra is the radiance, relative to the lamp's.
    """
    direct = exchange.direct[:, lamp, None]
    if not (direct * (shares @ reflectances)).any():
        return np.zeros((len(shares), 1)), np.zeros((1, reflectances.shape[1]))
    if max_reflections is None:
        shapes, amplitudes = _reduced_solution(exchange.form_factors, direct, shares, reflectances)
    else:
        rho = shares @ reflectances
        b = solve_exchange(exchange, rho, direct, max_reflections)
        shapes, amplitudes = b / np.maximum(rho, 1e-12) - direct, np.eye(b.shape[1])
    factors, spectra = [], []
    masks = shares.T > 0
    for share, mask, reflectance in zip(shares.T, masks, reflectances, strict=True):
        checkpoint()
        q, r = np.linalg.qr(share[mask, None].astype(shapes.dtype) * shapes[mask])
        factors.append(q)
        spectra.append((r @ amplitudes) * reflectance)
    left_vectors, singular, right_vectors = np.linalg.svd(np.concatenate(spectra), full_matrices=False)
    rank = max(1, int(np.sum(singular > TOLERANCE * singular[0])))
    mixed = np.split(left_vectors[:, :rank] * singular[:rank], np.cumsum([len(x) for x in spectra])[:-1])
    coefficients = np.zeros((len(shares), rank))
    for mask, q, mixing in zip(masks, factors, mixed, strict=True):
        coefficients[mask] += q @ mixing
    return coefficients, right_vectors[:rank]


def _reduced_solution(
    form_factors: NDArray, direct: NDArray, shares: NDArray, reflectances: NDArray
) -> tuple[NDArray, NDArray]:
    """F times the basis (p, n), and the amplitudes (n, w) of b in it."""
    rho = shares @ reflectances
    snapshots = np.unique(np.linspace(0, rho.shape[1] - 1, _SNAPSHOTS).astype(int))
    bounces = [(rho[:, snapshots] * direct).astype(np.float32)]
    for _ in range(_BOUNCES):
        checkpoint()
        bounces.append((rho[:, snapshots] * (form_factors @ bounces[-1])).astype(np.float32))
    checkpoint()
    space = _orthonormal(np.hstack(bounces).astype(np.float64))
    checkpoint()
    transported = form_factors @ space.astype(np.float32)
    for _ in range(_MOST_EXTENSIONS):
        checkpoint()
        amplitudes, residual, relative = _galerkin(space, transported, shares, reflectances, direct)
        checkpoint()
        unsolved = relative > TOLERANCE
        if not unsolved.any():
            break
        residual = residual[:, unsolved] / np.linalg.norm(residual[:, unsolved], axis=0)
        directions = _orthonormal(residual - space @ (space.T @ residual))
        space = np.hstack([space, directions])
        transported = np.hstack([transported, form_factors @ directions.astype(np.float32)])
    return transported[:, : len(amplitudes)], amplitudes


def _orthonormal(columns: NDArray) -> NDArray:
    """(p, n) orthonormal basis of the span of columns.

    Combinations below a millionth of the largest are left out.
    """
    singular, vectors = np.linalg.eigh(columns.T @ columns)
    significant = np.sqrt(np.maximum(singular, 0)) > 1e-6 * np.sqrt(max(singular[-1], 0))
    return np.linalg.qr(columns @ vectors[:, significant])[0]


def _galerkin(
    space: NDArray, transported: NDArray, shares: NDArray, reflectances: NDArray, direct: NDArray
) -> tuple[NDArray, NDArray, NDArray]:
    """Amplitudes of b = rho (e + F b) in a subspace, the residual, and its relative norm.

    `space` (p, n) is an orthonormal basis S and `transported` is F S. The amplitudes c (n, w) solve S^T (1 - rho F) S c
    = S^T rho e, a system of n equations at each wavelength. The residual is (p, w), and its norm over that of b (w,).
    """
    parts = [(space[mask] * share[mask, None], mask) for share, mask in zip(shares.T, shares.T > 0, strict=True)]
    operators = np.stack([part.T @ transported[mask] for part, mask in parts])
    sources = np.stack([part.T @ direct[mask, 0] for part, mask in parts])
    system = np.eye(space.shape[1]) - np.einsum("mw,mij->wij", reflectances, operators)
    amplitudes = np.linalg.solve(system, (reflectances.T @ sources)[..., None])[..., 0].T
    checkpoint()
    b = space @ amplitudes
    residual = (shares @ reflectances) * (direct + transported @ amplitudes) - b
    return amplitudes, residual, np.linalg.norm(residual, axis=0) / np.maximum(np.linalg.norm(b, axis=0), 1e-300)
