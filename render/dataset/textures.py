"""Textures: reflectance that varies between those of two paints.

Walls, blocks, spheres and meshes have them. The reflectance is (1 - s) of the first paint and s of the second, with s
from 0 to 1 of a noise or of a grey image.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from cboxlab.scenes.scene import Material, Surface, Texture
from cboxlab.scenes.shapes import joined, quad_mesh
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import path_inside, referred
from cboxlab.utils.input_files import read_channels
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

__all__ = ["MOST_FEATURES", "MOST_PIXELS", "image_shares", "noise_shares", "side_surface", "textured", "wall_uv"]

#: Most features of a noise along an edge of its surface: smaller ones are below the pixels of usual pictures.
MOST_FEATURES = 32

#: Most pixels along an edge of a texture's image, which is stored with the model of every box.
MOST_PIXELS = 256

#: Pixels of a feature of a noise, between whose centres a texture is linear.
_PIXELS_PER_FEATURE = 8

#: Fewest pixels along an edge of a noise.
_FEWEST_PIXELS = 64

#: Standard deviation of the filter of a noise, in features: a feature is a bright and a dark place.
_WIDTH = 0.2


def noise_shares(features: float, contrast: float, generator: np.random.Generator) -> NDArray[np.float64]:
    """Smooth noise in which all shares of the second paint are as frequent.

    Parameters
    ----------
    features
        Number of bright and dark places along an edge.
    contrast
        Range of the shares about one half, 0 to 1.
    generator
        Random numbers.

    Returns
    -------
    NDArray
        (rows, columns) shares, 0 to 1.
    """
    count = max(_FEWEST_PIXELS, int(np.ceil(features)) * _PIXELS_PER_FEATURE)
    smooth = gaussian_filter(generator.standard_normal((count, count)), _WIDTH * count / features, mode="wrap")
    uniform = ndtr((smooth - smooth.mean()) / smooth.std())
    return np.asarray(0.5 + contrast * (uniform - 0.5))


def image_shares(name: str, folder: Path, where: str) -> NDArray[np.float64]:
    """Shares of the second paint of an image: 0 where it is black, 1 where it is white.

    Parameters
    ----------
    name
        Grey PNG, or an array of (rows, columns) from 0 to 1 as .npy.
    folder
        Folder of the recipe.
    where
        File and key for errors.

    Returns
    -------
    NDArray
        (rows, columns) shares, 0 to 1.

    Raises
    ------
    InputError
        If the file cannot be read, is too large, has several channels, or values outside 0 to 1.
    """
    try:
        channels = read_channels(path_inside(folder, name, where))
    except InputError as fault:
        raise referred(fault, where) from None
    rows, columns, count = channels.shape
    if count != 1 or max(rows, columns) > MOST_PIXELS:
        size = f"an image of {rows} rows, {columns} columns and {count} channels"
        raise InputError(where, size, f"a grey image of at most {MOST_PIXELS} x {MOST_PIXELS} pixels")
    if channels.min() < 0 or channels.max() > 1:
        bounds = f"values from {channels.min():g} to {channels.max():g} in {name}"
        raise InputError(where, bounds, "values from 0 (first paint) to 1 (second paint)")
    return channels[..., 0]


def textured(name: str, shares: NDArray[np.float64], paints: tuple[Spectrum, Spectrum]) -> Material:
    """Material of a texture.

    Parameters
    ----------
    name
        Its name.
    shares
        (rows, columns) shares of the second paint.
    paints
        Reflectances of the two paints.

    Returns
    -------
    Material
        The material.
    """
    texture = Texture(np.stack([1 - shares, shares], axis=-1), paints)
    return Material(name, texture.mean, texture=texture)


def wall_uv(vertices_mm: NDArray[np.float64], corners_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Texture coordinates of a wall, whose image fills it.

    Parameters
    ----------
    vertices_mm
        (n, 3) vertices in the plane of the wall, mm.
    corners_mm
        (4, 3) corners, counter-clockwise from the lit side, the first at the image's lower left, mm.

    Returns
    -------
    NDArray
        (n, 2) coordinates, u along the image's columns and v along its rows.
    """
    edges = np.array([corners_mm[1] - corners_mm[0], corners_mm[3] - corners_mm[0]])
    across, upwards = ((vertices_mm - corners_mm[0]) @ edges.T / np.sum(edges**2, axis=1)).T
    return np.stack([across, 1 - upwards], axis=1)


def side_surface(name: str, material: str, sides_mm: list[NDArray[np.float64]]) -> Surface:
    """Block with a texture, whose image fills each of its sides.

    Parameters
    ----------
    name
        Name of the surface.
    material
        Name of its material.
    sides_mm
        (4, 3) corners of each side, as of ``wall_uv``.

    Returns
    -------
    Surface
        The block.
    """
    vertices, faces = joined([quad_mesh(side) for side in sides_mm])
    uv = np.concatenate([wall_uv(side, side) for side in sides_mm])
    return Surface(name, material, vertices, faces, texture_uv=uv)
