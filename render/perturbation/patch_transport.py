"""Fast changes of a picture: the scene's light exchange as matrices, at a few wavelengths.

The change by an effect is small relative to the picture, so a coarser method suffices: surfaces are divided into
patches of constant radiance. All radiances are relative to the lamp's. Patches: b = rho (e + F b). Pixels:
L = Sum_f c_f rho_f (e_f + (G b)_f) over the fragments f of a pixel, one for each flat face it sees (the lamp's, if it
reflects, included; its emission is apart); c_f is the share
covered, e_f the direct irradiance over pi, G_fj the fraction of f's hemisphere covered by patch j. All rays are traced
once; an effect then takes a few matrix products, without new noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

from ..device import SobolPoints, cosine_hemisphere, dr, mi
from ..radiosity import LightField, direct_light, lamp_pattern, patch_of
from ..visibility import RAY_OFFSET_MM, Tracer, facet_coverage, intersect, pixel_rays

__all__ = ["PatchTransport", "build_patch_transport"]

#: Camera rays per pixel for its coverage by several faces. With 64 rays, noise contributes 0.04 to chi2 per sample;
#: the motion of a block by 0.3 mm contributes 0.06 (32 x 32 pixels).
_COVERAGE_SAMPLES = 512


@dataclass(frozen=True, eq=False)
class PatchTransport:
    """Exchange between lamp, patches, surroundings and pixels.

    pixel, face : (f,) of each fragment. coverage : (f,) c_f, 0 to 1. position : (f, 3) mm, intersection of the pixel's
    central ray with the plane of the face. direct : (f,) e_f. gather : (f, p) G. escape : (f,) fraction of the
    hemisphere that leaves the box. covered : (y, x) share of each pixel covered by any face. lamp_radiance : (y, x)
    share of a pixel covered by the lamp times the radiance there relative to the lamp's mean along its normal.
    """

    light: LightField
    camera: Camera
    pixel: NDArray[np.int64]
    face: NDArray[np.int64]
    coverage: NDArray[np.float64]
    position: NDArray[np.float64]
    direct: NDArray[np.float32]
    gather: NDArray[np.float32]
    escape: NDArray[np.float32]
    covered: NDArray[np.float64]
    lamp_radiance: NDArray[np.float64]

    @property
    def material(self) -> NDArray[np.int64]:
        """(f,) index of each fragment's material."""
        tracer = self.light.tracer
        first = np.array([np.argmax(tracer.facet == f) for f in range(len(tracer.facet_surface))])
        return tracer.material[first][self.face]

    @property
    def surface(self) -> NDArray[np.int64]:
        """(f,) index of each fragment's surface."""
        return self.light.tracer.facet_surface[self.face]

    def pixels(self, values: NDArray) -> NDArray[np.float64]:
        """Pictures (w, y, x) of the fragments' radiance (f, w)."""
        height, width = self.camera.height_px, self.camera.width_px
        weighted = self.coverage[:, None] * values
        flat = [np.bincount(self.pixel, column, minlength=height * width) for column in weighted.T]
        return np.array(flat, float).reshape(-1, height, width)


def build_patch_transport(
    light: LightField, camera: Camera, samples: int = 256, seed: int = 0
) -> PatchTransport:
    """Compute the exchange by tracing one camera ray and one gathering ray per sample."""
    tracer, patches = light.tracer, light.patches
    everything = facet_coverage(tracer, camera, _COVERAGE_SAMPLES, seed)
    reflecting = len(tracer.facet_surface) - int(
        not tracer.scene.lamp.reflects
    )  # the lamp's face is the last
    coverage = everything[..., :reflecting].reshape(-1, reflecting)
    pixel, face = np.nonzero(coverage > 0)
    fragments = len(pixel)
    index = np.full(coverage.shape[0] * (coverage.shape[1] + 1), fragments, np.uint32)
    index[pixel * (coverage.shape[1] + 1) + face] = np.arange(fragments)
    lookup = mi.UInt32(index)
    count, faces = coverage.shape[0], coverage.shape[1] + 1
    lane = dr.arange(mi.UInt32, count)
    rays = pixel_rays(camera, lane)
    points = SobolPoints(6, samples, lane, seed)
    matrix = dr.zeros(mi.Float, (fragments + 1) * len(patches))
    direct, escaped, seen = (dr.zeros(mi.Float, fragments + 1) for _ in range(3))
    glow, on_lamp = (dr.zeros(mi.Float, count) for _ in range(2))

    def body(i: mi.UInt32) -> tuple[mi.UInt32]:
        ray = rays(points.point(i, 2), points.point(i, 3))
        hit = intersect(tracer, ray)
        shaded, bright = hit.reflecting, hit.on_lamp
        dr.scatter_add(on_lamp, mi.Float(1), lane, bright)
        pattern = lamp_pattern(light.lamp, hit.position, -dr.dot(ray.d, light.lamp.normal))
        dr.scatter_add(glow, mi.Float(pattern), lane, bright)
        facet = dr.gather(mi.UInt32, tracer.packed_facet, hit.triangle, shaded)
        fragment = dr.gather(mi.UInt32, lookup, lane * faces + facet, shaded)
        arriving = direct_light(
            tracer, light.lamp, hit.position, hit.normal, points.point(i, 4), points.point(i, 5), shaded
        )
        direction = cosine_hemisphere(hit.normal, points.point(i, 0), points.point(i, 1))
        far = intersect(tracer, mi.Ray3f(hit.position + hit.normal * RAY_OFFSET_MM, direction), shaded)
        lit = far.reflecting
        patch = patch_of(patches, far.triangle, far.uv, lit)
        dr.scatter_add(direct, arriving, fragment, shaded)
        dr.scatter_add(seen, mi.Float(1), fragment, shaded)
        dr.scatter_add(escaped, mi.Float(1), fragment, shaded & ~far.valid)
        dr.scatter_add(matrix, mi.Float(1), fragment * len(patches) + patch, lit)
        return (i + 1,)

    total = dr.opaque(mi.UInt32, samples)
    dr.while_loop((dr.zeros(mi.UInt32, count),), lambda i: i < total, body)
    dr.eval(direct, escaped, seen, glow, on_lamp, matrix)
    own = (np.array(glow) / np.maximum(np.array(on_lamp), 1)).reshape(camera.height_px, camera.width_px)
    scale = (1 / np.maximum(np.array(seen), 1))[:-1].astype(np.float32)
    return PatchTransport(
        light, camera, pixel, face,
        coverage=coverage[pixel, face].astype(float),
        position=_positions(tracer, camera, pixel, face),
        direct=np.array(direct)[:-1] * scale,
        gather=np.array(matrix).reshape(fragments + 1, len(patches))[:-1] * scale[:, None],
        escape=np.array(escaped)[:-1] * scale,
        covered=everything.sum(axis=-1).astype(float),
        lamp_radiance=everything[..., -1] * own,
    )  # fmt: skip


def _positions(tracer: Tracer, camera: Camera, pixel: NDArray, face: NDArray) -> NDArray[np.float64]:
    """(f, 3) intersections of the pixels' central rays with the planes of the faces, clipped to their extent."""
    row, column = np.divmod(pixel, camera.width_px)
    direction = camera.directions(column.astype(float), row.astype(float))
    positions = np.empty((len(pixel), 3))
    for f in np.unique(face):
        own, triangles = face == f, tracer.facet == f
        corner, normal = tracer.vertices[triangles][0, 0], tracer.normals[triangles][0]
        slope = direction[own] @ normal
        distance = ((corner - camera.position_mm) @ normal) / np.where(np.abs(slope) < 1e-9, 1e-9, slope)
        extent = tracer.vertices[triangles].reshape(-1, 3)
        points = camera.position_mm + distance[:, None] * direction[own]
        positions[own] = np.clip(points, extent.min(axis=0), extent.max(axis=0))
    return positions
