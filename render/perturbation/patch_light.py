"""A picture with changed materials and surroundings; see ``patch_transport``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

from ..radiosity import solve_exchange
from .patch_transport import PatchTransport

__all__ = ["PatchLight", "band_shares", "patch_light", "with_albedo"]


@dataclass(frozen=True, eq=False)
class PatchLight:
    """Reflectances and sources of light for each band.

    All radiances are relative to the lamps' mean in that band; w bands, p patches, f fragments of pixels.
    """

    #: Exchange between patches, lamps and pixels.
    transport: PatchTransport
    #: Materials and lamps.
    scene: Scene
    #: (w,) wavelengths at which the bands' reflectances are evaluated, nm.
    wavelength_nm: NDArray[np.float64]
    #: (n,) wavelengths of spectra, nm.
    grid_nm: NDArray[np.float64]
    #: (w, n) weights of the bands on grid_nm.
    weights: NDArray[np.float64]
    #: (n,) mean radiance of the lamps on grid_nm (``Scene.lamp_radiance``).
    lamp: NDArray[np.float64]
    #: (lamps, w) each lamp's signal over that of the mean.
    lamp_shares: NDArray[np.float64]
    #: (p, w) reflectance of the patches.
    patch_reflectance: NDArray[np.float64]
    #: (f, w) reflectance of the fragments.
    fragment_reflectance: NDArray[np.float64]
    #: (p, w) radiance that patches emit in addition to reflection.
    patch_emission: NDArray[np.float64]
    #: (f, w) radiance that fragments emit in addition to reflection.
    fragment_emission: NDArray[np.float64]
    #: (w,) radiance of the surroundings, seen through the opening.
    surround: NDArray[np.float64]
    #: (w, y, x) further radiance of the picture.
    added: NDArray[np.float64]
    #: Largest number of reflections between lamp and camera; None for no limit.
    max_bounces: int | None
    #: Rays of effects that trace additional ones.
    samples: int
    #: (w, y, x) light of coats at the surfaces seen, a part of the picture; None where it is not asked for.
    specular: NDArray[np.float64] | None = None

    def change(self, **values: Any) -> PatchLight:
        """Copy with other arrays.

        Parameters
        ----------
        **values
            Fields to replace.

        Returns
        -------
        PatchLight
            The copy.
        """
        return replace(self, **values)

    def over_lamp(self, spectrum: NDArray) -> NDArray[np.float64]:
        """Signal of a spectrum relative to that of the lamps' mean.

        Parameters
        ----------
        spectrum
            (n,) radiance on ``grid_nm``, in the unit of ``lamp``.

        Returns
        -------
        NDArray
            (w,) ratio in each band.
        """
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

    def patch_radiance(self, near: PatchLight | None = None) -> NDArray[np.float64]:
        """Outgoing radiance of the patches: b = rho (e + F b), plus what they emit.

        Parameters
        ----------
        near
            Nearly the same light of the same patches, from whose solution this one begins. None begins at darkness.

        Returns
        -------
        NDArray
            (p, w) radiance after up to ``max_bounces`` - 1 reflections.
        """
        exchange = self.transport.light.exchange
        first = self.patch_direct + np.outer(exchange.escape, self.surround)
        emitted = exchange.form_factors @ self.patch_emission.astype(np.float32)
        cut = None if self.max_bounces is None else self.max_bounces - 1
        if cut is not None and cut < 1:
            return self.patch_emission
        arriving = first + emitted
        start = None if near is None else near.patch_radiance() - near.patch_emission
        return self.patch_emission + self.transport.cached(
            ("solution", cut, self.patch_reflectance, arriving),
            lambda: solve_exchange(exchange, self.patch_reflectance, arriving, cut, start),
        )

    def picture(self) -> NDArray[np.float64]:
        """Radiance of the picture.

        Returns
        -------
        NDArray
            (w, y, x) radiance relative to the lamps' mean; with ``max_bounces`` = 0 the lamps alone.
        """
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
    """Light of a scene with its materials and lamps alone.

    Parameters
    ----------
    transport
        Exchange, whose geometry is used.
    scene
        Materials and lamps.
    wavelength_nm
        (w,) wavelengths of the reflectances, nm.
    grid_nm
        (n,) wavelengths of spectra, nm.
    weights
        (w, n) weights of the bands on ``grid_nm``.
    lamp
        (n,) unit of the radiances: ``Scene.lamp_radiance`` on ``grid_nm``, or any multiple at each wavelength.
    max_bounces
        Largest number of reflections between lamp and camera; None for no limit.
    samples
        Rays of effects that trace additional ones.

    Returns
    -------
    PatchLight
        Light without emission and without surroundings.
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
    """Signal of each lamp over that of the lamps' mean.

    Parameters
    ----------
    scene
        The lamps.
    grid_nm
        (n,) wavelengths, nm.
    weights
        (w, n) weights of the bands.
    lamp
        (n,) radiance of the lamps' mean, or any multiple at each wavelength.

    Returns
    -------
    NDArray
        (lamps, w) ratios; 1 in bands in which no lamp shines.
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
    """Light with another albedo of one material's patches, separate for the lamps' direct light.

    Parameters
    ----------
    light
        Light of the scene.
    material
        Index of the material.
    diffuse
        Albedo for diffuse light, a function of the reflectance (n, w).
    direct
        Albedo for direct light, a function of the reflectance (n, w) and the cosine (n, 1) towards a lamp's centre.

    Returns
    -------
    PatchLight
        Light whose patches reflect with these albedos; reflected light is diffuse.
    """
    field = light.transport.light
    of_material = field.patches.material == material
    rho = light.patch_reflectance[of_material]
    reflectance, emission = light.patch_reflectance.copy(), light.patch_emission.copy()
    reflectance[of_material] = diffuse(rho)
    if light.max_bounces is None or light.max_bounces > 1:
        for lamp, shares, arriving in zip(
            field.lamps, light.lamp_shares, field.exchange.direct[of_material].T, strict=True
        ):
            way = lamp.centre - field.patches.centre[of_material]
            cosine = np.einsum("px,px->p", way, field.patches.normal[of_material]) / np.linalg.norm(way, axis=1)
            more = direct(rho, np.clip(cosine, 0, 1)[:, None]) - reflectance[of_material]
            emission[of_material] += more * np.outer(arriving, shares)
    return light.change(patch_reflectance=reflectance, patch_emission=emission)
