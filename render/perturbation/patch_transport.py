"""Fast changes of a picture: the scene's light exchange as matrices, at a few wavelengths.

The change by an effect is small relative to the picture, so a coarser method suffices: surfaces are divided into
patches of constant radiance. All radiances are relative to a lamp's. Patches: b = rho (e + F b). Pixels:
L = Sum_f c_f rho_f (e_f + (G b)_f) over the fragments f of a pixel, one for each flat face that it sees. Faces of lamps
that reflect are among them; the lamps' emission is apart. c_f is the share covered, e_f the direct irradiance over pi,
G_fj the fraction of f's hemisphere covered by patch j. All rays are traced once; an effect then takes a few matrix
products, without new noise. A fragment's rays meet about a twelfth of the patches, so G is sparse: each ray notes the
number of its entry, and equal numbers are counted. Pixels are traced by strips.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.utils.progress import checkpoint
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from ..device import SobolPoints, cosine_hemisphere, device_array, dr, lanes_per_call, mi
from ..radiosity import PatchedScene, direct_light, lamp_seen, patch_of
from ..visibility import RAY_OFFSET_MM, Tracer, facet_coverage, intersect, pixel_rays
from .spreading import grid_step, spreading

__all__ = ["PatchTransport", "build_patch_transport"]

#: Camera rays per pixel for its coverage by several faces, where it is not known exactly. With 64 rays, noise
#: contributes 0.04 to chi2 per sample; the motion of a block by 0.3 mm contributes 0.06 (32 x 32 pixels).
_COVERAGE_SAMPLES = 512

#: Rays whose entries of G are noted at once: 32 MiB.
_RAYS = 2**23

#: Number of no entry of G: that of a ray that meets no patch.
_NO_ENTRY = 2**32 - 1

#: Solutions and traced changes in memory: those of one effect, while others are tried together with it.
_MAX_RESULTS = 12


@dataclass(frozen=True, eq=False)
class PatchTransport:
    """Exchange between lamps, patches, surroundings and pixels: f fragments, p patches."""

    #: Scene with its patches and lamps.
    light: PatchedScene
    #: Camera of the picture.
    camera: Camera
    #: (f,) pixel of each fragment, counted along the rows.
    pixel: NDArray[np.int64]
    #: (f,) flat face of each fragment.
    face: NDArray[np.int64]
    #: (f,) c_f, 0 to 1.
    coverage: NDArray[np.float64]
    #: (f, 3) intersection of the pixel's central ray with the plane of the face, mm.
    position: NDArray[np.float64]
    #: (f, lamps) e_f by each lamp.
    direct: NDArray[np.float32]
    #: (f, p) G.
    gather: csr_array
    #: (f,) fraction of the hemisphere that leaves the box.
    escape: NDArray[np.float32]
    #: (y, x) share of each pixel that any face covers.
    covered: NDArray[np.float64]
    #: (lamps, y, x) share of a pixel covered by a lamp.
    lamp_coverage: NDArray[np.float32]
    #: (lamps, y, x) the same times the radiance there over the lamp's mean along its normal.
    lamp_radiance: NDArray[np.float64]
    _results: dict[tuple[Any, ...], NDArray[Any]] = field(default_factory=dict, init=False, repr=False)

    def cached(self, of: tuple[Any, ...], compute: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """Result for this geometry, computed before from the same numbers or now.

        Parameters
        ----------
        of
            Numbers, texts and arrays that determine the result.
        compute
            Computes the result.

        Returns
        -------
        NDArray
            The result; the last _MAX_RESULTS stay in memory.
        """
        key = tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in of)
        result = self._results.pop(key) if key in self._results else compute()
        self._results[key] = result  # the last one used comes last
        if len(self._results) > _MAX_RESULTS:
            del self._results[next(iter(self._results))]
        return result

    @property
    def face_alone(self) -> NDArray[np.int64]:
        """(y, x) index of the only flat face that a pixel sees, -1 for several."""
        face = np.full(self.covered.shape, -1)
        alone = self.coverage == 1
        face.flat[self.pixel[alone]] = self.face[alone]
        return face

    @cached_property
    def spread(self) -> csr_array | None:
        """Weights by which traced pixels stand for all (``spreading``); None where all are."""
        step = grid_step(self.covered.size)
        if step == 1:
            return None
        light, alone = np.zeros(self.covered.shape), self.coverage == 1
        # the light that white patches reflect makes up for the depth of shadows
        arriving = (self.direct + self.gather @ self.light.exchange.direct).sum(axis=1)
        light.flat[self.pixel[alone]] = arriving[alone]
        return spreading(self.face_alone, light, step)

    @property
    def _triangle(self) -> NDArray[np.int64]:
        """(f,) a triangle of each fragment's face."""
        tracer = self.light.tracer
        return np.array([np.argmax(tracer.facet == f) for f in range(len(tracer.facet_surface))])[self.face]

    @property
    def material(self) -> NDArray[np.int64]:
        """(f,) index of each fragment's material."""
        return self.light.tracer.material[self._triangle]

    @property
    def normal(self) -> NDArray[np.float64]:
        """(f, 3) normal of each fragment's face."""
        return self.light.tracer.normals[self._triangle]

    @property
    def surface(self) -> NDArray[np.int64]:
        """(f,) index of each fragment's surface."""
        return self.light.tracer.facet_surface[self.face]

    def pixels_of(self, material: int) -> NDArray[np.int64]:
        """Pixels that see a material.

        Parameters
        ----------
        material
            Index of the material.

        Returns
        -------
        NDArray
            (n,) pixels, counted along the rows.
        """
        return np.unique(self.pixel[self.material == material])

    def pixels(self, values: NDArray) -> NDArray[np.float64]:
        """Pictures of the fragments' radiance.

        Parameters
        ----------
        values
            (f, w) radiance.

        Returns
        -------
        NDArray
            (w, y, x) sums over fragments, weighted with their coverage.
        """
        height, width = self.camera.height_px, self.camera.width_px
        weighted = self.coverage[:, None] * values
        flat = [np.bincount(self.pixel, column, minlength=height * width) for column in weighted.T]
        return np.array(flat, float).reshape(-1, height, width)


def build_patch_transport(
    light: PatchedScene, camera: Camera, samples: int = 256, seed: int = 0, alike: PatchTransport | None = None
) -> PatchTransport:
    """Exchange of a scene, traced with one camera ray and one gathering ray per sample.

    Parameters
    ----------
    light
        Scene with its patches and lamps.
    camera
        Camera of the picture.
    samples
        Camera rays per pixel.
    seed
        Seed of the random numbers.
    alike
        Exchange by the same rays of the same surfaces, under lamps of other patterns; None for none. Then only the
        lamps' light is traced, with the same result.

    Returns
    -------
    PatchTransport
        The exchange.
    """
    if alike is not None:
        return _relit(alike, light, samples, seed)
    tracer = light.tracer
    everything = facet_coverage(tracer, camera, _COVERAGE_SAMPLES, seed)
    lamps = len(light.lamps)  # each has one face; they are the last
    reflects = tracer.reflectors > len(tracer.material_names)
    reflecting = len(tracer.facet_surface) - (0 if reflects else lamps)
    coverage = everything[..., :reflecting].reshape(-1, reflecting)
    pixel, face = np.nonzero(coverage > 0)
    strips = [
        _traced(light, camera, (first, last), pixel, face, samples, seed)
        for first, last in _strips(pixel, len(coverage), len(light.patches), samples)
    ]
    dr.flush_malloc_cache()  # the strips' matrices
    direct, glow, escape = (np.concatenate([strip[i] for strip in strips]) for i in range(3))
    lamp_coverage = np.moveaxis(everything[..., -lamps:], -1, 0)
    return PatchTransport(
        light,
        camera,
        pixel,
        face,
        coverage=coverage[pixel, face].astype(float),
        position=_positions(tracer, camera, pixel, face),
        direct=direct,
        gather=csr_array(vstack([strip[3] for strip in strips])),
        escape=escape,
        covered=everything.sum(axis=-1).astype(float),
        lamp_coverage=lamp_coverage,
        lamp_radiance=lamp_coverage * glow.T.reshape(lamp_coverage.shape),
    )


def _relit(alike: PatchTransport, light: PatchedScene, samples: int, seed: int) -> PatchTransport:
    """Exchange of the same surfaces under lamps of other patterns, whose light alone is traced."""
    pixel, face, camera = alike.pixel, alike.face, alike.camera
    strips = [
        _traced(light, camera, (first, last), pixel, face, samples, seed, with_exchange=False)
        for first, last in _strips(pixel, alike.covered.size, 1, samples)  # no matrix
    ]
    direct, glow = (np.concatenate([strip[i] for strip in strips]) for i in range(2))
    radiance = alike.lamp_coverage * glow.T.reshape(alike.lamp_coverage.shape)
    return replace(alike, light=light, direct=direct, lamp_radiance=radiance)


def _strips(pixel: NDArray[np.int64], pixels: int, patches: int, samples: int) -> list[tuple[int, int]]:
    """First pixel and end of each strip.

    It has up to ``_RAYS`` rays, and entries of G with numbers of 32 bits.
    """
    most = lanes_per_call(samples, max(1, _RAYS // samples))
    before = np.searchsorted(pixel, np.arange(pixels + 1))  # fragments of the pixels before
    ends = [0]
    while ends[-1] < pixels:
        end = int(np.searchsorted(before, before[ends[-1]] + _NO_ENTRY // patches - 1, "right")) - 1
        ends.append(min(max(end, ends[-1] + 1), ends[-1] + most))
    return list(pairwise(ends))


def _traced(
    light: PatchedScene,
    camera: Camera,
    pixels: tuple[int, int],
    pixel: NDArray,
    face: NDArray,
    samples: int,
    seed: int,
    *,
    with_exchange: bool = True,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], csr_array]:
    """Exchange of a strip of pixels.

    Returns direct light of its fragments, the lamps' patterns of its pixels, and escape and G of its fragments, empty
    without the exchange.
    """
    checkpoint()
    tracer, patches = light.tracer, light.patches
    count, faces = pixels[1] - pixels[0], len(tracer.facet_surface) + 1
    of_strip = slice(*np.searchsorted(pixel, pixels))
    fragments = of_strip.stop - of_strip.start
    index = np.full(count * faces, fragments, np.uint32)
    index[(pixel[of_strip] - pixels[0]) * faces + face[of_strip]] = np.arange(fragments)
    lookup = device_array(mi.UInt32, index)
    lane = dr.arange(mi.UInt32, count)
    strip_pixel = lane + dr.opaque(mi.UInt32, pixels[0])
    rays = pixel_rays(camera, strip_pixel)
    points = SobolPoints(6, samples, strip_pixel, seed)
    entries = dr.full(mi.UInt32, _NO_ENTRY, count * samples if with_exchange else 1)
    patch_count, total = (dr.opaque(mi.UInt32, number) for number in (len(patches), samples))
    escaped, ray_count = (dr.zeros(mi.Float, fragments + 1) for _ in range(2))
    direct = [dr.zeros(mi.Float, fragments + 1) for _ in light.lamps]
    glow, on_lamp = ([dr.zeros(mi.Float, count) for _ in light.lamps] for _ in range(2))

    def body(i: mi.UInt32) -> tuple[mi.UInt32]:
        ray = rays(points.point(i, 2), points.point(i, 3))
        hit = intersect(tracer, ray)
        shaded = hit.reflecting
        facet = dr.gather(mi.UInt32, tracer.packed_facet, hit.triangle, shaded)
        fragment = dr.gather(mi.UInt32, lookup, lane * faces + facet, shaded)
        for k, lamp in enumerate(light.lamps):
            bright = hit.on_lamp & (hit.material == lamp.material)
            dr.scatter_add(on_lamp[k], mi.Float(1), lane, bright, mode=dr.ReduceMode.Direct)
            dr.scatter_add(glow[k], lamp_seen(lamp, hit, ray.d), lane, bright, mode=dr.ReduceMode.Direct)
            u, v = points.point(i, 4), points.point(i, 5)
            arriving = direct_light(tracer, lamp, hit.position, hit.normal, u, v, shaded)
            dr.scatter_add(direct[k], arriving, fragment, shaded, mode=dr.ReduceMode.Direct)
        dr.scatter_add(ray_count, mi.Float(1), fragment, shaded, mode=dr.ReduceMode.Direct)
        if with_exchange:
            direction = cosine_hemisphere(hit.normal, points.point(i, 0), points.point(i, 1))
            far = intersect(tracer, mi.Ray3f(hit.position + hit.normal * RAY_OFFSET_MM, direction), shaded)
            on_patch = far.reflecting
            patch = patch_of(patches, far.triangle, far.uv, on_patch)
            dr.scatter_add(escaped, mi.Float(1), fragment, shaded & ~far.valid, mode=dr.ReduceMode.Direct)
            dr.scatter(entries, fragment * patch_count + patch, lane * total + i, on_patch)
        return (i + 1,)

    dr.while_loop((dr.zeros(mi.UInt32, count),), lambda i: i < total, body)
    dr.eval(direct, escaped, ray_count, glow, on_lamp, entries)
    scale = (1 / np.maximum(np.array(ray_count), 1))[:-1].astype(np.float32)
    shining = [np.array(g) / np.maximum(np.array(n), 1) for g, n in zip(glow, on_lamp, strict=True)]
    arriving = np.stack([np.array(lamp_sum)[:-1] * scale for lamp_sum in direct], axis=1)
    gather = _counted(entries.numpy().reshape(count if with_exchange else 1, -1), fragments, len(patches), scale)
    return arriving, np.stack(shining, axis=1), np.array(escaped)[:-1] * scale, gather


def _counted(entries: NDArray, fragments: int, patches: int, scale: NDArray[np.float32]) -> csr_array:
    """G from the numbers of the rays' entries.

    A row of ``entries`` has the rays of one pixel; (f,) ``scale`` is one over the number of a fragment's rays. Pixels
    have their fragments in order, so that sorted rows are sorted altogether.
    """
    ordered = np.sort(entries, axis=1).ravel()
    ordered = ordered[ordered < fragments * patches]  # without rays that meet no patch, or a face that has no share
    first = np.flatnonzero(np.diff(ordered, prepend=np.uint32(_NO_ENTRY)))
    row, column = np.divmod(ordered[first], np.uint32(patches))
    counts = np.diff(first, append=len(ordered)).astype(np.float32)
    # indices of 32 bits suffice for a picture's strips together, and take half the memory of SciPy's own choice
    ends = np.searchsorted(row, np.arange(fragments + 1, dtype=np.uint32)).astype(np.int32)
    return csr_array((counts * scale[row], column.astype(np.int32), ends), shape=(fragments, patches))


def _positions(tracer: Tracer, camera: Camera, pixel: NDArray, face: NDArray) -> NDArray[np.float64]:
    """(f, 3) points where the pixels' central rays meet the faces' planes, inside their extent."""
    row, column = np.divmod(pixel, camera.width_px)
    direction = camera.directions(column.astype(float), row.astype(float))
    positions = np.empty((len(pixel), 3))
    for f in np.unique(face):
        on_face, triangles = face == f, tracer.facet == f
        corner, normal = tracer.vertices[triangles][0, 0], tracer.normals[triangles][0]
        slope = direction[on_face] @ normal
        distance = ((corner - camera.position_mm) @ normal) / np.where(np.abs(slope) < 1e-9, 1e-9, slope)
        extent = tracer.vertices[triangles].reshape(-1, 3)
        points = camera.position_mm + distance[:, None] * direction[on_face]
        positions[on_face] = np.clip(points, extent.min(axis=0), extent.max(axis=0))
    return positions
