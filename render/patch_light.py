"""A picture under changed surfaces and surroundings, from the patches' exchange; see ``patch_transport``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

from .patch_transport import PatchTransport
from .radiosity import solve

__all__ = ["PatchLight", "patch_light", "with_albedo"]


@dataclass(frozen=True, eq=False)
class PatchLight:
    """What lights the picture, band by band, everything over the lamp's own radiance in that band.

    wavelength_nm : (w,) at which each band's paints are evaluated. weights : (w, n) of the bands on grid_nm (n,);
    lamp : (n,) its radiance there. patch_reflectance : (p, w), fragment_reflectance : (f, w).
    patch_emission, fragment_emission : (p, w), (f, w) radiance sent out besides reflection.
    surround : (w,) radiance of what the opening shows. added : (w, y, x) radiance that none of this describes.
    max_bounces : reflections between lamp and camera, None for all. samples : of what still has to be traced.
    """

    transport: PatchTransport
    scene: Scene
    wavelength_nm: NDArray[np.float64]
    grid_nm: NDArray[np.float64]
    weights: NDArray[np.float64]
    lamp: NDArray[np.float64]
    patch_reflectance: NDArray[np.float64]
    fragment_reflectance: NDArray[np.float64]
    patch_emission: NDArray[np.float64]
    fragment_emission: NDArray[np.float64]
    surround: NDArray[np.float64]
    added: NDArray[np.float64]
    max_bounces: int | None
    samples: int

    def change(self, **values: Any) -> PatchLight:
        """A copy with other arrays."""
        return replace(self, **values)

    def over_lamp(self, spectrum: NDArray) -> NDArray[np.float64]:
        """(w,) signal of a radiance spectrum (n,) over that of the lamp, band by band."""
        return (self.weights @ spectrum) / (self.weights @ self.lamp)

    def patch_radiance(self) -> NDArray[np.float64]:
        """(p, w) radiance that the patches send out."""
        exchange = self.transport.light.exchange
        first = exchange.direct[:, None] + np.outer(exchange.escape, self.surround)
        emitted = exchange.form_factors @ self.patch_emission.astype(np.float32)
        cut = None if self.max_bounces is None else self.max_bounces - 1
        if cut is not None and cut < 1:
            return self.patch_emission
        return solve(exchange, self.patch_reflectance, first + emitted, cut) + self.patch_emission

    def picture(self) -> NDArray[np.float64]:
        """(w, y, x) radiance over the lamp's."""
        t = self.transport
        if self.max_bounces == 0:
            return np.broadcast_to(t.lamp_radiance, self.added.shape).astype(float)
        arriving = t.direct[:, None] + t.gather @ self.patch_radiance().astype(np.float32)
        arriving = arriving + np.outer(t.escape, self.surround)
        picture = t.pixels(self.fragment_reflectance * arriving + self.fragment_emission)
        return picture + t.lamp_radiance + self.surround[:, None, None] * (1 - t.covered) + self.added


def patch_light(
    transport: PatchTransport, scene: Scene, wavelength_nm: NDArray, grid_nm: NDArray, weights: NDArray, lamp: NDArray,
    max_bounces: int | None = None, samples: int = 256,
) -> PatchLight:  # fmt: skip
    """The scene as it is, its paints and no other light; its geometry is that of ``transport``."""
    table = np.array([m.reflectance.at(wavelength_nm) for m in scene.materials.values()])
    patches, fragments, bands = len(transport.light.patches), len(transport.pixel), len(wavelength_nm)
    shape = (bands, transport.camera.height_px, transport.camera.width_px)
    return PatchLight(
        transport, scene, wavelength_nm, grid_nm, weights, lamp,
        patch_reflectance=table[transport.light.patches.material],
        fragment_reflectance=table[transport.material],
        patch_emission=np.zeros((patches, bands)),
        fragment_emission=np.zeros((fragments, bands)),
        surround=np.zeros(bands),
        added=np.zeros(shape),
        max_bounces=max_bounces,
        samples=samples,
    )  # fmt: skip


def with_albedo(
    light: PatchLight,
    paint: int,
    diffuse: Callable[[NDArray], NDArray],
    direct: Callable[[NDArray, NDArray], NDArray],
) -> PatchLight:
    """The patches of one paint with another albedo, and one of its own for light from the lamp's direction.

    diffuse : albedo for light from everywhere, of the paint's reflectance (n, w). direct : of (n, w) and the
    cosines (n, 1) under which the lamp's centre is seen. What is reflected counts as diffuse.
    """
    field = light.transport.light
    own = field.patches.material == paint
    rho = light.patch_reflectance[own]
    triangle = field.patches.triangle[own]
    way = field.lamp.centre - field.patches.centre[own]
    cosine = np.einsum("px,px->p", way, field.tracer.normals[triangle]) / np.linalg.norm(way, axis=1)
    reflectance, emission = light.patch_reflectance.copy(), light.patch_emission.copy()
    reflectance[own] = diffuse(rho)
    if light.max_bounces is None or light.max_bounces > 1:
        more = direct(rho, np.clip(cosine, 0, 1)[:, None]) - reflectance[own]
        emission[own] += more * field.exchange.direct[own][:, None]
    return light.change(patch_reflectance=reflectance, patch_emission=emission)
