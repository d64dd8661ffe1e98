"""Patterns: walls and blocks of rectangular tiles, each of one paint.

Each tile is a separate flat face. Coverage by paint, albedo and light are then as exact as those of a plain face.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from cboxlab.scenes.scene import Surface
from cboxlab.scenes.shapes import Mesh, joined, quad_mesh
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import path_inside, referred
from cboxlab.utils.input_files import read_channels
from numpy.typing import NDArray

__all__ = ["MOST_BLOCK_TILES", "MOST_TILES", "drawn_tiles", "image_tiles", "tiled"]

#: Most tiles along one side of a wall: smaller ones are below the pixels of usual pictures.
MOST_TILES = 32

#: Most tiles along one edge of a block, whose five visible sides each have the pattern.
MOST_BLOCK_TILES = 8


def drawn_tiles(kind: str, size: tuple[int, int], paints: int, generator: np.random.Generator) -> NDArray[np.int64]:
    """Paint of each tile of a procedural pattern.

    Parameters
    ----------
    kind
        "checker", "stripes" (upright ones), or "random" (each tile independently).
    size
        Rows and columns.
    paints
        Number of paints.
    generator
        Random numbers, used for "random" alone.

    Returns
    -------
    NDArray
        (rows, columns) index of each tile's paint.
    """
    if kind == "random":
        return generator.integers(paints, size=size)
    row, column = np.indices(size)
    return np.asarray((column if kind == "stripes" else row + column) % paints)


def image_tiles(name: str, paints: int, folder: Path, where: str) -> NDArray[np.int64]:
    """Paint of each tile of an image, one tile for a pixel.

    Parameters
    ----------
    name
        Grey PNG, or an array of (rows, columns) as .npy. Its levels, in rising order, stand for the paints.
    paints
        Number of paints.
    folder
        Folder of the recipe.
    where
        File and key for errors.

    Returns
    -------
    NDArray
        (rows, columns) index of each tile's paint.

    Raises
    ------
    InputError
        If the file cannot be read, is too large, or has not one level for each paint.
    """
    try:
        channels = read_channels(path_inside(folder, name, where))
    except InputError as fault:
        raise referred(fault, where) from None
    rows, columns, count = channels.shape
    if count != 1 or max(rows, columns) > MOST_TILES:
        size = f"an image of {rows} rows, {columns} columns and {count} channels"
        raise InputError(where, size, f"a grey image of at most {MOST_TILES} x {MOST_TILES} pixels, one for each tile")
    levels, tiles = np.unique(channels[..., 0], return_inverse=True)
    if len(levels) != paints:
        raise InputError(where, f"{len(levels)} grey levels in {name}", f"{paints} levels, one for each paint")
    return tiles.reshape(rows, columns)


def tiled(name: str, sides: Sequence[tuple[NDArray[np.float64], NDArray[np.str_]]]) -> list[Surface]:
    """Surfaces of a tiled wall or block, one for each paint in use.

    Parameters
    ----------
    name
        Name of the wall or block.
    sides
        Of each flat side its (4, 3) corners, counter-clockwise from the lit side, mm, the first at the lower left of
        the pattern; and the (rows, columns) name of each tile's paint, the first row upper.

    Returns
    -------
    list of Surface
        The surfaces, named NAME-PAINT, with one quad for each tile.
    """
    quads: dict[str, list[Mesh]] = {}
    for corners, tiles in sides:
        rows, columns = tiles.shape
        across = np.outer(np.arange(columns + 1) / columns, corners[1] - corners[0])
        upwards = np.outer(np.arange(rows, -1, -1) / rows, corners[3] - corners[0])
        points = corners[0] + upwards[:, None] + across
        each = np.stack([points[1:, :-1], points[1:, 1:], points[:-1, 1:], points[:-1, :-1]], axis=2)
        for paint in np.unique(tiles):
            quads.setdefault(str(paint), []).extend(quad_mesh(quad) for quad in each[tiles == paint])
    return [Surface(f"{name}-{paint}", paint, *joined(meshes)) for paint, meshes in sorted(quads.items())]
