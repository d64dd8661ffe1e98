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

__all__ = ["PatchLight", "band_shares", "patch_light", "with_albedo"]


@dataclass(frozen=True, eq=False)
class PatchLight:
    """Reflectances and sources of light for each band; all radiances are relative to the lamps' mean in that band.

    wavelength_nm : (w,) at which each band's reflectances are evaluated. weights : (w, n) of the bands on grid_nm
    (n,); lamp : (n,) the lamps' mean radiance there (``Scene.lamp_radiance``). lamp_shares : (lamps, w) each lamp's
    signal over that of the mean. patch_reflectance : (p, w), fragment_reflectance : (f, w).
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
    lamp_shares: NDArray[np.float64]
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
        """(w,) signal of a radiance spectrum (n,) relative to that of the lamps' mean, in each band."""
        return (self.weights @ spectrum) / (self.weights @ self.lamp)

    @property
    def patch_direct(self) -> NDArray[np.float64]:
        """(p, w) direct irradiance of the patches by all lamps, over pi."""
        return self.transport.light.exchange.direct @ self.lamp_shares

    @property
    def fragment_direct(self) -> NDArray[np.float64]:
        """(f, w) direct irradiance of the fragments by all lamps, over pi."""
        return self.transport.direct @ self.lamp_shares

    @property
    def seen_lamps(self) -> NDArray[np.float64]:
        """(w, y, x) radiance of the lamps that the pixels see."""
        return np.einsum("jw,jyx->wyx", self.lamp_shares, self.transport.lamp_radiance)

    def patch_radiance(self) -> NDArray[np.float64]:
        """(p, w) outgoing radiance of the patches."""
        exchange = self.transport.light.exchange
        first = self.patch_direct + np.outer(exchange.escape, self.surround)
        emitted = exchange.form_factors @ self.patch_emission.astype(np.float32)
        cut = None if self.max_bounces is None else self.max_bounces - 1
        if cut is not None and cut < 1:
            return self.patch_emission
        arriving = first + emitted
        return self.patch_emission + self.transport.kept(
            ("solution", cut, self.patch_reflectance, arriving),
            lambda: solve(exchange, self.patch_reflectance, arriving, cut),
        )

    def picture(self) -> NDArray[np.float64]:
        """(w, y, x) radiance relative to the lamps' mean."""
        t = self.transport
        if self.max_bounces == 0:
            return self.seen_lamps
        arriving = self.fragment_direct + t.gather @ self.patch_radiance().astype(np.float32)
        arriving = arriving + np.outer(t.escape, self.surround)
        picture = t.pixels(self.fragment_reflectance * arriving + self.fragment_emission)
        return picture + self.seen_lamps + self.surround[:, None, None] * (1 - t.covered) + self.added


def patch_light(
    transport: PatchTransport,
    scene: Scene,
    wavelength_nm: NDArray,
    grid_nm: NDArray,
    weights: NDArray,
    lamp: NDArray,
    *,
    max_bounces: int | None = None,
    samples: int = 256,
) -> PatchLight:
    """The scene with its own materials and no other light source; the geometry is that of ``transport``.

    lamp : (n,) the unit of the radiances, ``Scene.lamp_radiance`` on grid_nm or any multiple at each wavelength.
    """
    table = scene.reflectances(wavelength_nm)
    patches, fragments, bands = len(transport.light.patches), len(transport.pixel), len(wavelength_nm)
    shape = (bands, transport.camera.height_px, transport.camera.width_px)
    return PatchLight(
        transport,
        scene,
        wavelength_nm,
        grid_nm,
        weights,
        lamp,
        band_shares(scene, grid_nm, weights, lamp),
        patch_reflectance=table[transport.light.patches.material],
        fragment_reflectance=table[transport.material],
        patch_emission=np.zeros((patches, bands)),
        fragment_emission=np.zeros((fragments, bands)),
        surround=np.zeros(bands),
        added=np.zeros(shape),
        max_bounces=max_bounces,
        samples=samples,
    )


def band_shares(scene: Scene, grid_nm: NDArray, weights: NDArray, lamp: NDArray) -> NDArray[np.float64]:
    """(lamps, w) signal of each lamp over that of the lamps' mean; 1 in bands in which none shines.

    weights : (w, n) on grid_nm (n,). lamp : (n,) the lamps' mean, or any multiple at each wavelength.
    """
    if not scene.further_lamps:
        return np.ones((1, len(weights)))
    signals = (scene.lamp_shares(grid_nm) * lamp) @ weights.T
    mean = weights @ lamp
    return np.divide(signals, mean, out=np.ones_like(signals), where=mean > 0)


def with_albedo(
    light: PatchLight,
    material: int,
    diffuse: Callable[[NDArray], NDArray],
    direct: Callable[[NDArray, NDArray], NDArray],
) -> PatchLight:
    """The patches of one material with another albedo, and a separate albedo for the lamps' direct light.

    diffuse : albedo for diffuse light, as a function of the reflectance (n, w). direct : albedo for direct light, as
    a function of the reflectance (n, w) and the cosine (n, 1) towards a lamp's centre. Reflected light is diffuse.
    """
    field = light.transport.light
    own = field.patches.material == material
    rho = light.patch_reflectance[own]
    reflectance, emission = light.patch_reflectance.copy(), light.patch_emission.copy()
    reflectance[own] = diffuse(rho)
    if light.max_bounces is None or light.max_bounces > 1:
        for lamp, shares, arriving in zip(field.lamps, light.lamp_shares, field.exchange.direct[own].T, strict=True):
            way = lamp.centre - field.patches.centre[own]
            cosine = np.einsum("px,px->p", way, field.patches.normal[own]) / np.linalg.norm(way, axis=1)
            more = direct(rho, np.clip(cosine, 0, 1)[:, None]) - reflectance[own]
            emission[own] += more * np.outer(arriving, shares)
    return light.change(patch_reflectance=reflectance, patch_emission=emission)
