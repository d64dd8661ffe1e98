"""Boxes of one geometry that share the solution of light and the rays of a picture.

A final gather is linear in a basis of spectra, and its rays do not depend on wavelength. Boxes whose spectra alone
differ are one box with as many more wavelengths: those of the first box, then those of the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from cboxlab.scenes.scene import Lamp, Scene
from cboxlab.scenes.spectra import Spectrum
from numpy.typing import NDArray

from ..image import RenderedImage
from .drawing import Box

__all__ = ["joined_scene", "sharing_rays", "split_image"]

#: Stages of effects that change a box's geometry, its cameras, or the number of reflections.
_OWN_RAYS = ("scene", "settings", "camera")


def sharing_rays(boxes: Sequence[Box]) -> list[list[Box]]:
    """Boxes of one geometry in groups that may share rays.

    Parameters
    ----------
    boxes
        Boxes of one geometry.

    Returns
    -------
    list of list of Box
        The groups, in the order of their first boxes. A box with an effect on scene, camera or settings is alone.
    """
    groups: dict[object, list[Box]] = {}
    for box in boxes:
        apart = any(effect.stage in _OWN_RAYS for effect in box.model.effects)
        reflecting = any(lamp.reflects for lamp in box.model.scene.lamps)
        groups.setdefault(("apart", box.number) if apart else ("shared", reflecting), []).append(box)
    return list(groups.values())


def joined_scene(scenes: Sequence[Scene], wavelength_nm: NDArray[np.float64]) -> tuple[Scene, NDArray[np.float64]]:
    """One scene whose wavelengths are those of several, one after another.

    Parameters
    ----------
    scenes
        Scenes that differ in spectra alone.
    wavelength_nm
        (w,) wavelengths of each, nm.

    Returns
    -------
    scene : Scene
        The scene; a single one is returned as it is.
    wavelength_nm : NDArray
        (scenes w,) wavelengths in the scene: numbers from 1, which stand for those of each in turn.
    """
    first = scenes[0]
    if len(scenes) == 1:
        return first, wavelength_nm
    grid = np.arange(1.0, len(scenes) * wavelength_nm.size + 1)

    def joined(spectra: Sequence[Spectrum]) -> Spectrum:
        return Spectrum(grid, np.concatenate([spectrum.at(wavelength_nm) for spectrum in spectra]))

    materials = {
        name: replace(material, reflectance=joined([scene.materials[name].reflectance for scene in scenes]))
        for name, material in first.materials.items()
    }

    def joined_lamp(lamps: Sequence[Lamp]) -> Lamp:
        radiance, reflectance = joined([x.radiance for x in lamps]), joined([x.reflectance for x in lamps])
        return replace(lamps[0], radiance=radiance, reflectance=reflectance)

    lamps = [joined_lamp(each) for each in zip(*(scene.lamps for scene in scenes), strict=True)]
    return replace(first, materials=materials, lamp=lamps[0], further_lamps=tuple(lamps[1:])), grid


def split_image(image: RenderedImage, count: int, wavelength_nm: NDArray[np.float64]) -> list[RenderedImage]:
    """Image of each of several joined scenes.

    Parameters
    ----------
    image
        Image of the joined scene.
    count
        Number of scenes.
    wavelength_nm
        (w,) wavelengths of each, nm.

    Returns
    -------
    list of RenderedImage
        The images, with the same coefficients.
    """
    spectra = np.split(image.spectra, count, axis=1)
    return [replace(image, spectra=part, wavelength_nm=wavelength_nm) for part in spectra]
