"""Faces visible in each pixel, by camera rays or as exact areas."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from cboxlab.scenes.camera import Camera
from scipy.ndimage import maximum_filter, minimum_filter

from ..device import SobolPoints, device_array, dr, mi
from .face_edges import face_edges, pixels_on_edges
from .faces_and_tree import FacesAndTree
from .flat_faces import FlatFaces
from .polygon_coverage import polygon_coverage
from .tracer import Tracer, intersect, pixel_rays

__all__ = ["border_pixels", "facet_coverage", "pixel_coverage", "pixel_faces"]

#: Lanes per pixel in the estimate of coverage by rays.
_LANES = 16

#: Distance from the bounding box of a mesh or ball, px, within which a pixel may show more than flat faces.
_MARGIN_PX = 2.0


def facet_coverage(tracer: Tracer, camera: Camera, samples: int = 64, seed: int = 0) -> np.ndarray:
    """Share of each pixel covered by each flat face.

    Exact for a few dozen flat faces, and for those next to meshes and balls. Elsewhere pixels crossed by an edge are
    estimated by `samples` low-discrepancy camera rays. So are pixels that show another face than a neighbour without an
    edge in between (surfaces that intersect). All other pixels use one ray.

    Parameters
    ----------
    tracer
        The prepared scene.
    camera
        Camera of the image.
    samples
        Camera rays of a pixel that is estimated.
    seed
        Seed of these rays.

    Returns
    -------
    NDArray
        (y, x, f) float32 shares, 0 to 1, lamps last; the rest to 1 is not covered.
    """
    crossed = pixels_on_edges(camera, face_edges(tracer.vertices, tracer.facet))
    centres = pixel_rays(camera, dr.arange(mi.UInt32, crossed.size))(mi.Float(0.5), mi.Float(0.5))
    face = _faces(tracer, centres).reshape(crossed.shape)
    faces = len(tracer.facet_surface)
    coverage = np.eye(faces + 1, faces, dtype=np.float32)[face]  # its last row, of zeros, is that of no face
    highest = maximum_filter(np.where(crossed, -2, face), 3)
    lowest = minimum_filter(np.where(crossed, faces, face), 3)
    mixed = np.flatnonzero(crossed | (lowest < highest))
    if len(mixed):
        coverage.reshape(crossed.size, -1)[mixed] = pixel_coverage(tracer, [camera], mixed, samples, seed)[0]
    return coverage


def border_pixels(coverage: np.ndarray) -> np.ndarray:
    """Pixels that show several faces, or have a neighbour that shows another face.

    Parameters
    ----------
    coverage
        (y, x, f) coverage of `facet_coverage`.

    Returns
    -------
    NDArray
        (n,) pixels, counted along the rows.
    """
    face = np.where(coverage.max(axis=-1) == 1, coverage.argmax(axis=-1), -1)
    face[~coverage.any(axis=-1)] = -2
    return np.flatnonzero((maximum_filter(face, 3) != minimum_filter(face, 3)) | (face == -1))


def pixel_coverage(
    tracer: Tracer, cameras: Sequence[Camera], pixels: np.ndarray, samples: int, seed: int = 0
) -> np.ndarray:
    """Coverage as by `facet_coverage`, of some pixels of several cameras.

    Parameters
    ----------
    tracer
        The prepared scene.
    cameras
        c cameras of one image size.
    pixels
        (n,) pixels, counted along the rows.
    samples
        Camera rays of a pixel, the same for all cameras; not used for a few flat faces.
    seed
        Seed of these rays.

    Returns
    -------
    NDArray
        (c, n, f) float32 shares, 0 to 1.
    """
    accelerator, pixels = tracer.accelerator, np.asarray(pixels)
    if isinstance(accelerator, FlatFaces):
        return _by_polygons(tracer, accelerator, np.arange(len(tracer.facet)), cameras, pixels)
    near = np.ones(len(pixels), bool)
    coverage = np.empty((len(cameras), len(pixels), len(tracer.facet_surface)), np.float32)
    if isinstance(accelerator, FacesAndTree):
        flat_triangles = np.array(accelerator.face_triangles)
        near = _near_others(tracer, flat_triangles, cameras, pixels)
        coverage[:, ~near] = _by_polygons(tracer, accelerator.faces, flat_triangles, cameras, pixels[~near])
    if near.any():
        coverage[:, near] = [_by_rays(tracer, camera, pixels[near], samples, seed) for camera in cameras]
    return coverage


def _near_others(tracer: Tracer, flat: np.ndarray, cameras: Sequence[Camera], pixels: np.ndarray) -> np.ndarray:
    """(n,) whether pixels may show triangles of no flat face through any of the cameras.

    `flat` holds the indices of the triangles of flat faces. The others are bounded by one box per surface; all pixels
    count if a corner of a box has no image.
    """
    rows, columns = np.divmod(pixels, cameras[0].width_px)
    others = np.setdiff1d(np.arange(len(tracer.facet)), flat)
    near = np.zeros(len(pixels), bool)
    for surface in np.unique(tracer.surface[others]):
        points = tracer.vertices[others[tracer.surface[others] == surface]].reshape(-1, 3)
        box = np.array([*product(*zip(points.min(axis=0), points.max(axis=0), strict=True))])
        image = np.concatenate([camera.project(box) for camera in cameras])
        if np.isnan(image).any():
            return np.ones(len(pixels), bool)
        (left, top), (right, bottom) = image.min(axis=0) - _MARGIN_PX, image.max(axis=0) + _MARGIN_PX
        near |= (columns > left) & (columns < right) & (rows > top) & (rows < bottom)
    return near


def _by_rays(tracer: Tracer, camera: Camera, pixels: np.ndarray, samples: int, seed: int) -> np.ndarray:
    """(n, f) coverage by rays.

    Neighbouring lanes share a pixel, so that their rays meet the same parts of the tree.
    """
    count, faces = len(pixels), len(tracer.facet_surface)
    lanes = _LANES if samples % _LANES == 0 else 1
    lane = dr.arange(mi.UInt32, count * lanes)
    pixel = dr.gather(mi.UInt32, device_array(mi.UInt32, pixels), lane // lanes)
    rays = pixel_rays(camera, pixel)
    points = SobolPoints(2, samples, pixel, seed)
    counts = dr.zeros(mi.Float, count * faces)
    pixel_start, first = lane // lanes * faces, lane % lanes * (samples // lanes)

    def body(i: mi.UInt32) -> tuple[mi.UInt32]:
        hit = intersect(tracer, rays(points.point(first + i, 0), points.point(first + i, 1)), coherent=True)
        facet = dr.gather(mi.UInt32, tracer.packed_facet, hit.triangle, hit.front)
        dr.scatter_add(counts, mi.Float(1), pixel_start + facet, hit.front, mode=dr.ReduceMode.Direct)
        return (i + 1,)

    total = dr.opaque(mi.UInt32, samples // lanes)
    dr.while_loop((dr.zeros(mi.UInt32, count * lanes),), lambda i: i < total, body)
    dr.eval(counts)
    return counts.numpy().reshape(count, faces) / np.float32(samples)


def _by_polygons(
    tracer: Tracer, faces: FlatFaces, triangles: np.ndarray, cameras: Sequence[Camera], pixels: np.ndarray
) -> np.ndarray:
    """(c, n, f) coverage by exact areas: the lit sides of polygons, summed by flat face.

    Back sides only hide what is behind them. `triangles` gives for each triangle of `faces` its index in the scene.
    """
    eyes = np.array([camera.position_mm for camera in cameras])
    front = eyes @ faces.planes[:, 0, :3].T > faces.planes[:, 0, 3]
    facet = tracer.facet[triangles[np.array(faces.triangles)[::2]]]
    facet_rows = np.eye(len(tracer.facet_surface), dtype=np.float32)[facet]
    return polygon_coverage(faces, cameras, pixels) @ (facet_rows * front[..., None])


def pixel_faces(tracer: Tracer, camera: Camera, pixels: np.ndarray, across: int, seed: int = 0) -> np.ndarray:
    """Face visible in each subpixel of some pixels.

    Rays are jittered within the subpixels, so that edges along rows or columns are not biased to one side.

    Parameters
    ----------
    tracer
        The prepared scene.
    camera
        Camera of the image.
    pixels
        (n,) pixels, counted along the rows.
    across
        Number of subpixels along each axis.
    seed
        Seed of the jitter.

    Returns
    -------
    NDArray
        (n, across, across) int16 index of the flat face, -1 for none.
    """
    jitter = np.random.default_rng(seed).random((2, len(pixels), across, across))
    v, u = (np.arange(across)[:, None] + jitter[0]) / across, (np.arange(across) + jitter[1]) / across
    rays = pixel_rays(camera, device_array(mi.UInt32, np.repeat(pixels, across**2)))
    return _faces(tracer, rays(*(device_array(mi.Float, x) for x in (u, v)))).reshape(jitter.shape[1:])


def _faces(tracer: Tracer, rays: mi.Ray3f) -> np.ndarray:
    """(n,) int16 flat face that each ray hits from its lit side, -1 for none."""
    hit = intersect(tracer, rays, coherent=True)
    facet = dr.gather(mi.UInt32, tracer.packed_facet, hit.triangle, hit.front)
    dr.eval(hit.front, facet)  # together: one kernel
    return np.where(np.array(hit.front), np.array(facet).astype(np.int16), np.int16(-1))
