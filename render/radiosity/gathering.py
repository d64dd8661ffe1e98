"""The kernels of the final gather.

One lane per pixel, one symbolic loop over its camera rays, and one over their gathering rays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cboxlab.scenes.camera import Camera

from ..device import SobolPoints, cosine_hemisphere, dr, mi
from ..visibility import RAY_OFFSET_MM, Hit, Tracer, intersect, pixel_rays
from .direct_cells import DirectCells
from .face_controls import CONTROLLED, FaceControls
from .lamp import LampSampler, direct_light, lamp_seen
from .mixtures import Mixtures
from .patches import Patches, patch_of

__all__ = ["PACKET", "Gathering", "Planes"]

#: Numbers that are read together from the table of the patches' light, whose rows are padded to a multiple.
PACKET = 4

#: Gathering rays per camera ray (if the number of samples is a multiple). Camera rays contribute little noise: with 2
#: the product of time and variance is 20% smaller than with 1; with 4 it is the same as with 2 but edges are noisier.
GATHERS = 2

#: Gathering rays of a pixel from which the shares of the control variate are estimated.
_PILOT = 64

#: Smallest number of camera rays of a pixel at which the mean of the control variate is evaluated.
_CONTROL_RAYS = 4
#: Samples of a pixel for each such camera ray, if that gives more of them. With four alone the error does not decrease
#: beyond 1024 samples.
_SAMPLES_PER_CONTROL = 64


if TYPE_CHECKING:
    from .face_controls import Controls

    #: Of the walls' and of the blocks' light.
    Shares = tuple[mi.Float, mi.Float]


@dataclass(frozen=True, eq=False)
class Planes:
    """Pixels that show one plane each."""

    #: Pixel of each lane, counted along the rows.
    pixels: mi.UInt32
    #: Unit normal N of the plane, towards the camera.
    normal: mi.Vector3f
    #: N . p for points p of the plane, mm.
    height: mi.Float

    def point_on(self, ray: mi.Ray3f) -> mi.Point3f:
        """Point of the plane on each lane's ray.

        Parameters
        ----------
        ray
            Ray of each lane.

        Returns
        -------
        Point3f
            The point, mm.
        """
        return ray((self.height - dr.dot(self.normal, ray.o)) * dr.rcp(dr.dot(self.normal, ray.d)))


@dataclass(frozen=True, eq=False)
class _Sampling:
    """Sample points of a pixel: camera rays and one joint set of numbers."""

    #: Camera ray by position in the pixel.
    rays: Callable[[mi.Float, mi.Float], mi.Ray3f]
    #: Points of 12 numbers: directions of gathering rays (0, 1), lamp points at their hits (2, 3), pixel (4, 5), lamp
    #: point at its hit (6, 7), continued rays (8, 9) and lamp points at their hits (10, 11).
    points: SobolPoints
    #: Gathering rays per camera ray.
    gathers: int

    def ray(self, i: mi.UInt32) -> mi.Ray3f:
        """Camera ray of this index."""
        return self.rays(self.points.point(i, 4), self.points.point(i, 5))


def _sampling(camera: Camera, pixels: mi.UInt32, samples: int, seed: int | mi.UInt32) -> _Sampling:
    """Sample points of pixels."""
    gathers = GATHERS if samples % GATHERS == 0 else 1
    return _Sampling(pixel_rays(camera, pixels), SobolPoints(12, samples, pixels, seed), gathers)


@dataclass(frozen=True, eq=False)
class Gathering:
    """Light of one lamp, as sums over a pixel's gathering rays.

    One accumulator holds the visible lamp. Then each first material has `per_material` accumulators: direct light,
    direct light of second materials, of second and third materials, and light read from the patches; see
    `final_gather`.
    """

    #: Tracer of the scene.
    tracer: Tracer
    #: Sampler of the lamp.
    lamp: LampSampler
    #: Patches from which the solution is read.
    patches: Patches
    #: Number of patches.
    patch_count: mi.UInt32
    #: (1 + material, patch, rank) coefficients of the patches' light, with the rank padded to a multiple of PACKET.
    table: mi.Float
    #: Number of accumulators for it.
    rank: int
    #: Direct light in cells.
    direct: DirectCells
    #: Control variate for pixels that show one plane; None for none.
    controls: FaceControls | None
    #: Number of first materials.
    firsts: int
    #: Number of second, or third, materials.
    materials: int
    #: Largest number of reflections, at most 3, which stands for all.
    bounces: int
    #: Length below which gathering rays are continued, mm.
    near: mi.Float
    #: Mixtures of the surfaces; None for a scene without any.
    mixtures: Mixtures | None = None

    @property
    def per_material(self) -> int:
        return 1 + self.materials + self.materials**2 + self.rank

    def any_pixels(self, camera: Camera, pixels: mi.UInt32, samples: int, seeds: mi.UInt32) -> list[mi.Float]:
        """Sums of pixels that may show anything.

        Parameters
        ----------
        camera
            Camera of the image.
        pixels
            Pixel of each lane, counted along the rows.
        samples
            Samples of a pixel.
        seeds
            Seed of each lane.

        Returns
        -------
        list[Float]
            The 1 + firsts * per_material accumulators.
        """
        sampling = _sampling(camera, pixels, samples, seeds)

        def body(i: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
            ray = sampling.ray(i)
            hit = intersect(self.tracer, ray)
            shaded = hit.reflecting
            part = self._part_of(hit, self._shares(hit, self.firsts, shaded), shaded)
            values = self._reflected(sampling, i, hit.position, hit.normal, shaded, None)
            new = [sums[0] + sampling.gathers * lamp_seen(self.lamp, hit, ray.d)]
            for m in range(self.firsts):
                material_sums = sums[1 + m * self.per_material : 1 + (m + 1) * self.per_material]
                new += [old + part(m, value) for old, value in zip(material_sums, values, strict=True)]
            return i + 1, new

        total = dr.opaque(mi.UInt32, samples // sampling.gathers)
        zeros = [dr.zeros(mi.Float, dr.width(pixels)) for _ in range(1 + self.firsts * self.per_material)]
        return dr.while_loop((dr.zeros(mi.UInt32, dr.width(pixels)), zeros), lambda i, _: i < total, body)[1]

    def planar_pixels(
        self, camera: Camera, planes: Planes, shares: Shares | None, samples: int, seeds: mi.UInt32
    ) -> list[mi.Float]:
        """Sums of pixels that show one plane of one paint.

        Parameters
        ----------
        camera
            Camera of the image.
        planes
            The pixels and their planes.
        shares
            Shares of `control_shares`; None to use no control variate.
        samples
            Samples of a pixel.
        seeds
            Seed of each lane.

        Returns
        -------
        list[Float]
            The per_material accumulators.
        """
        sampling = _sampling(camera, planes.pixels, samples, seeds)
        shaded = dr.full(mi.Bool, True, dr.width(planes.pixels))

        def body(i: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
            at = planes.point_on(sampling.ray(i))
            values = self._reflected(sampling, i, at, planes.normal, shaded, shares)
            return i + 1, [old + value for old, value in zip(sums, values, strict=True)]

        zero = dr.zeros(mi.UInt32, dr.width(planes.pixels))
        sums = [dr.zeros(mi.Float, dr.width(planes.pixels)) for _ in range(self.per_material)]
        if shares is not None and self.controls is not None:
            controls = self.controls
            few = min(max(_CONTROL_RAYS, samples // _SAMPLES_PER_CONTROL), samples // sampling.gathers)
            enough, share = dr.opaque(mi.UInt32, few), dr.opaque(mi.Float, samples / few)

            def returned(i: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
                start = planes.point_on(sampling.ray(i)) + planes.normal * RAY_OFFSET_MM
                mean = self._spread(controls.mean(start, planes.normal, self.materials), shares)
                return i + 1, [old + value * share for old, value in zip(sums, mean, strict=True)]

            sums = dr.while_loop((zero, sums), lambda i, _: i < enough, returned)[1]
        total = dr.opaque(mi.UInt32, samples // sampling.gathers)
        return dr.while_loop((zero, sums), lambda i, _: i < total, body)[1]

    def control_shares(self, camera: Camera, planes: Planes, weights: list[float], seed: int) -> Shares | None:
        """Shares of the walls' and the blocks' light in the control variate, by pilot rays.

        They leave the least variance. The pilot has random numbers that the image does not use, so the image remains
        unbiased.

        Parameters
        ----------
        camera
            Camera of the image.
        planes
            The pixels and their planes.
        weights
            (per_material) weights of the accumulators in the light whose variance counts.
        seed
            Seed of the pilot.

        Returns
        -------
        Shares | None
            The shares of each pixel; None without controls.
        """
        if self.controls is None or self.bounces < 3:
            return None
        controls, sampling = self.controls, _sampling(camera, planes.pixels, _PILOT, seed)
        lanes = dr.width(planes.pixels)
        shaded, full, zero = dr.full(mi.Bool, True, lanes), mi.Float(1), mi.Float(0)
        most = max(map(abs, weights)) or 1.0
        scales = [dr.opaque(mi.Float, float(weight / most)) for weight in weights]

        def light(values: list[mi.Float]) -> mi.Float:
            return sum((scale * value for scale, value in zip(scales, values, strict=True)), zero)

        def body(i: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
            at, points = planes.point_on(sampling.ray(i)), sampling.points
            values = self._gathered(points, i, at, planes.normal, shaded, None)
            along = controls.along(self._gathering_ray(points, i, at, planes.normal), self.materials, shaded)
            v, w, b = (
                light(values),
                light(self._spread(along, (full, zero))),
                light(self._spread(along, (zero, full))),
            )
            more = [v, w, b, v * w, v * b, w * w, w * b, b * b]
            return i + 1, [old + new for old, new in zip(sums, more, strict=True)]

        total = dr.opaque(mi.UInt32, _PILOT)
        start = dr.zeros(mi.UInt32, lanes), [dr.zeros(mi.Float, lanes) for _ in range(8)]
        sums = dr.while_loop(start, lambda i, _: i < total, body)[1]
        return least_variance_shares([value / _PILOT for value in sums])

    def _spread(self, controls: Controls, shares: Shares) -> list[mi.Float]:
        """Shares of light of `FaceControls`, in the order of a material's accumulators."""
        controlled = [shares[0] * wall + shares[1] * block for wall, block in zip(*controls, strict=True)]
        ranks = min(CONTROLLED, self.rank)
        second, patches = controlled[: self.materials], controlled[self.materials :][:ranks]
        nothing = [mi.Float(0)] * self.materials**2
        return [mi.Float(0), *second, *nothing, *patches, *([mi.Float(0)] * (self.rank - ranks))]

    def _reflected(
        self,
        sampling: _Sampling,
        i: mi.UInt32,
        position: mi.Point3f,
        normal: mi.Vector3f,
        shaded: mi.Bool,
        shares: Shares | None,
    ) -> list[mi.Float]:
        """Values (per_material) of one camera ray: direct light, and light of its gathering rays."""
        points, gathers = sampling.points, sampling.gathers
        values = [mi.Float(0)] * self.per_material
        if self.bounces >= 1:
            u, v = points.point(i, 6), points.point(i, 7)
            values[0] = gathers * direct_light(self.tracer, self.lamp, position, normal, u, v, shaded)
        if self.bounces < 2:
            return values

        def body(j: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
            more = self._gathered(points, j, position, normal, shaded, shares)
            return j + 1, [old + value for old, value in zip(sums, more, strict=True)]

        end, lanes = (i + 1) * gathers, dr.width(position)
        zeros = [dr.zeros(mi.Float, lanes) for _ in values]
        gathered = dr.while_loop((i * gathers, zeros), lambda j, _: j < end, body)[1]
        return [values[0], *gathered[1:]]

    def _gathered(
        self,
        points: SobolPoints,
        i: mi.UInt32,
        position: mi.Point3f,
        normal: mi.Vector3f,
        shaded: mi.Bool,
        shares: Shares | None,
    ) -> list[mi.Float]:
        """Values (per_material) of one gathering ray, without direct light at `position`."""
        ray = self._gathering_ray(points, i, position, normal)
        far = intersect(self.tracer, ray, shaded)
        reflects, material = far.reflecting, far.material
        near_cells = reflects & (far.distance < self.direct.far)
        arriving = dr.if_stmt(
            (near_cells, i, far.position, far.normal, self.direct.at(far, reflects)),
            near_cells,
            lambda active, i, at, towards, _: direct_light(
                self.tracer, self.lamp, at, towards, points.point(i, 2), points.point(i, 3), active
            ),
            lambda *state: state[-1],
        )
        mixed = self._shares(far, self.materials, reflects)
        part = self._part_of(far, mixed, reflects)
        second = [part(m, arriving) for m in range(self.materials)]
        nothing = [mi.Float(0)] * self.materials**2
        if self.bounces < 3:
            return [mi.Float(0), *second, *nothing, *([mi.Float(0)] * self.rank)]
        close = reflects & (far.distance < self.near) & (material < self.materials)
        read = [*nothing, *self._read(mi.UInt32(0), far.triangle, far.uv, reflects & ~close)]
        later = dr.if_stmt(
            (close, i, far.position, far.normal, material, mixed, read),
            close,
            lambda active, i, at, towards, of, mixed, _: self._continued(
                points, i, at, towards, of, mixed=mixed, close=active
            ),
            lambda *state: state[-1],
        )
        values = [mi.Float(0), *second, *later]
        if shares is not None and self.controls is not None:
            controlled = self._spread(self.controls.along(ray, self.materials, shaded), shares)
            values = [value - off for value, off in zip(values, controlled, strict=True)]
        return values

    @staticmethod
    def _gathering_ray(points: SobolPoints, i: mi.UInt32, position: mi.Point3f, normal: mi.Vector3f) -> mi.Ray3f:
        """Cosine-distributed ray from a surface."""
        direction = cosine_hemisphere(normal, points.point(i, 0), points.point(i, 1))
        return mi.Ray3f(position + normal * RAY_OFFSET_MM, direction)

    def _shares(self, hit: Hit, count: int, active: mi.Bool) -> list[mi.Float]:
        """Shares of the materials at hits; empty for a scene without mixtures."""
        return [] if self.mixtures is None else self.mixtures.shares(hit, count, active)

    @staticmethod
    def _part_of(hit: Hit, shares: list[mi.Float], active: mi.Bool) -> Callable[[int, mi.Float], mi.Float]:
        """Function of a material and light at hits that returns the part of its share."""
        if shares:
            return lambda m, value: shares[m] * value
        return lambda m, value: dr.select(active & (hit.material == m), value, 0)

    def _continued(
        self,
        points: SobolPoints,
        i: mi.UInt32,
        position: mi.Point3f,
        normal: mi.Vector3f,
        material: mi.UInt32,
        *,
        mixed: list[mi.Float],
        close: mi.Bool,
    ) -> list[mi.Float]:
        """Values of one more ray from a second reflection: direct and the patches' light at its end.

        The second reflection is by a material, or by several with the shares ``mixed``.
        """
        onward = cosine_hemisphere(normal, points.point(i, 8), points.point(i, 9))
        last = intersect(self.tracer, mi.Ray3f(position + normal * RAY_OFFSET_MM, onward), close)
        reflects = last.reflecting
        u, v = points.point(i, 10), points.point(i, 11)
        arriving = direct_light(self.tracer, self.lamp, last.position, last.normal, u, v, reflects)
        if mixed:
            part = self._part_of(last, self._shares(last, self.materials, reflects), reflects)
            third = [share * part(n, arriving) for share in mixed for n in range(self.materials)]
            rows = [
                [share * value for value in self._read(mi.UInt32(m + 1), last.triangle, last.uv, reflects)]
                for m, share in enumerate(mixed)
            ]
            return [*third, *(sum(column, mi.Float(0)) for column in zip(*rows, strict=True))]
        third = [
            dr.select(reflects & (material == m) & (last.material == n), arriving, 0)
            for m in range(self.materials)
            for n in range(self.materials)
        ]
        return [*third, *self._read(material + 1, last.triangle, last.uv, reflects)]

    def _read(self, row: mi.UInt32, triangle: mi.UInt32, uv: mi.Point2f, active: mi.Bool) -> list[mi.Float]:
        """A row of the table at a hit."""
        patch = patch_of(self.patches, triangle, uv, active)
        packets = -(-self.rank // PACKET)
        first = (patch + row * self.patch_count) * packets
        numbers = [x for k in range(packets) for x in dr.gather(mi.Vector4f, self.table, first + k, active)]
        return numbers[: self.rank]


def least_variance_shares(means: list[mi.Float]) -> Shares:
    """Shares x and y, 0 to 1 each, with the least variance of v - x w - y b.

    They solve the 2 x 2 normal equations of the covariances. A millionth is added to the variances of w and b, which
    may be 0.

    Parameters
    ----------
    means
        Means of v, w, b, v w, v b, w w, w b, b b.

    Returns
    -------
    Shares
        x and y.
    """
    v, w, b, vw, vb, ww, wb, bb = means
    vw, vb, ww, wb, bb = vw - v * w, vb - v * b, ww - w * w, wb - w * b, bb - b * b
    tiny = 1e-6 * (ww + bb) + 1e-15
    rest = (ww + tiny) * (bb + tiny) - wb * wb
    shares = (vw * (bb + tiny) - vb * wb) / rest, (vb * (ww + tiny) - vw * wb) / rest
    return dr.clip(shares[0], 0, 1), dr.clip(shares[1], 0, 1)
