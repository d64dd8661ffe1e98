"""A picture with changed materials and surroundings, from the exchange between patches; see ``patch_transport``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

from ..radiosity import solve
from .patch_transport import PatchTransport

__all__ = ["PatchLight", "patch_light", "with_albedo"]


@dataclass(frozen=True, eq=False)
class PatchLight:
    """Reflectances and sources of light for each band; all radiances are relative to the lamp's in that band.

    wavelength_nm : (w,) at which each band's reflectances are evaluated. weights : (w, n) of the bands on grid_nm
    (n,); lamp : (n,) its radiance there. patch_reflectance : (p, w), fragment_reflectance : (f, w).
    patch_emission, fragment_emission : (p, w), (f, w) radiance emitted in addition to reflection.
    surround : (w,) radiance of the surroundings seen through the opening. added : (w, y, x) further radiance.
    max_bounces : largest number of reflections between lamp and camera, None for no limit. samples : for effects that
    trace additional rays.
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
        """(w,) signal of a radiance spectrum (n,) relative to that of the lamp, in each band."""
        return (self.weights @ spectrum) / (self.weights @ self.lamp)

    def patch_radiance(self) -> NDArray[np.float64]:
        """(p, w) outgoing radiance of the patches."""
        exchange = self.transport.light.exchange
        first = exchange.direct[:, None] + np.outer(exchange.escape, self.surround)
        emitted = exchange.form_factors @ self.patch_emission.astype(np.float32)
        cut = None if self.max_bounces is None else self.max_bounces - 1
        if cut is not None and cut < 1:
            return self.patch_emission
        return solve(exchange, self.patch_reflectance, first + emitted, cut) + self.patch_emission

    def picture(self) -> NDArray[np.float64]:
        """(w, y, x) radiance relative to the lamp's."""
        t = self.transport
        if self.max_bounces == 0:
            return np.broadcast_to(t.lamp_radiance, self.added.shape).astype(float)
        arriving = t.direct[:, None] + t.gather @ self.patch_radiance().astype(np.float32)
        arriving = arriving + np.outer(t.escape, self.surround)
        picture = t.pixels(self.fragment_reflectance * arriving + self.fragment_emission)
        return picture + t.lamp_radiance + self.surround[:, None, None] * (1 - t.covered) + self.added


def patch_light(
    transport: PatchTransport, scene: Scene, wavelength_nm: NDArray, grid_nm: NDArray, weights: NDArray, lamp: NDArray,
    *, max_bounces: int | None = None, samples: int = 256,
) -> PatchLight:  # fmt: skip
    """The scene with its own materials and no other light source; the geometry is that of ``transport``."""
    table = scene.reflectances(wavelength_nm)
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
    material: int,
    diffuse: Callable[[NDArray], NDArray],
    direct: Callable[[NDArray, NDArray], NDArray],
) -> PatchLight:
    """The patches of one material with another albedo, and a separate albedo for the lamp's direct light.

    diffuse : albedo for diffuse light, as a function of the reflectance (n, w). direct : albedo for direct light, as
    a function of the reflectance (n, w) and the cosine (n, 1) towards the lamp's centre. Reflected light is diffuse.
    """
    field = light.transport.light
    own = field.patches.material == material
    rho = light.patch_reflectance[own]
    way = field.lamp.centre - field.patches.centre[own]
    cosine = np.einsum("px,px->p", way, field.patches.normal[own]) / np.linalg.norm(way, axis=1)
    reflectance, emission = light.patch_reflectance.copy(), light.patch_emission.copy()
    reflectance[own] = diffuse(rho)
    if light.max_bounces is None or light.max_bounces > 1:
        more = direct(rho, np.clip(cosine, 0, 1)[:, None]) - reflectance[own]
        emission[own] += more * field.exchange.direct[own][:, None]
    return light.change(patch_reflectance=reflectance, patch_emission=emission)
