"""Rays asked of an accelerator, and what Embree's tree says of the same ones."""

import numpy as np
from cboxlab.rendering.device import dr, mi

#: Rays of a test.
COUNT = 200_000
#: Errors of single precision, mm: along a ray that meets its face at an angle, at coordinates up to a metre.
ROUNDING_MM = 2e-3


def normals_of(vertices):
    """(t, 3) of triangles (t, 3, 3)."""
    normals = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def directions(rng, count=COUNT):
    noise = rng.standard_normal((count, 3))
    return noise / np.linalg.norm(noise, axis=1, keepdims=True)


def rays(origin, direction):
    return mi.Ray3f(mi.Point3f(origin.T.astype(np.float32)), mi.Vector3f(direction.T.astype(np.float32)))


def hit_of(accelerator, ray, active=True):
    """Whether each ray meets anything, the distance, the triangle, its barycentric coordinates (2, n)."""
    dr.make_opaque(ray)  # a length is not part of a kernel's code
    hit = accelerator.ray_intersect_preliminary(ray, coherent=False, active=mi.Bool(active))
    dr.eval(hit)  # together: one kernel
    assert np.array_equal(np.array(hit.is_valid()), np.isfinite(np.array(hit.t)))
    return [np.array(part) for part in (hit.is_valid(), hit.t, hit.prim_index, hit.prim_uv)]


def blocked_by(accelerator, ray, **how):
    dr.make_opaque(ray)
    return np.array(accelerator.ray_test(ray, **how)).astype(bool)


def differing(first, other, normals, direction):
    """(n,) whether two answers of ``hit_of`` differ by more than rounding, off the plane that is met."""
    (hit, t, *_), (hit_tree, t_tree, triangle, _) = first, other
    met = hit & hit_tree
    angle = np.abs(np.einsum("ij,ij->i", normals[triangle % len(normals)], direction))
    off = np.abs(np.where(met, t, 0) - np.where(met, t_tree, 0)) * angle
    return (hit != hit_tree) | (off > ROUNDING_MM)


def between_surfaces(vertices, normals, triangles, rng):
    """Rays between points of triangles ``chosen`` (2, n), and which of them leave and reach lit sides."""
    weights = rng.dirichlet((1, 1, 1), size=triangles.shape)
    ends = np.einsum("ekc,ekcx->ekx", weights, vertices[triangles]) + 0.01 * normals[triangles]
    ray = rays(ends[0], ends[1] - ends[0])
    ray.maxt = 1 - 1e-4
    facing = np.einsum("ij,ij->i", ends[1] - ends[0], normals[triangles[0]]) > 0
    return ray, facing & (np.einsum("ij,ij->i", ends[0] - ends[1], normals[triangles[1]]) > 0)
