"""Colours of photograph and rendering, pixel by pixel or by cells of a mosaic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.instrument import cell_means, one_pixel_of_each_cell
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import ArrayLike, NDArray

from .colour_difference import (
    COLOUR_DIFFERENCES,
    NOISE_SEED,
    DifferenceStatistics,
    White,
    expected_from_noise,
    lab,
    white_of,
)

__all__ = ["PixelColours", "pixel_colours"]


@dataclass(frozen=True, eq=False)
class PixelColours(FrozenMappings):
    """Colours of photograph and rendering, pixel by pixel."""

    #: (y, x, 3) X, Y, Z of the photograph.
    xyz_measured: NDArray[np.float64]
    #: (y, x, 3) X, Y, Z of the rendering.
    xyz_rendered: NDArray[np.float64]
    #: The white of CIELab.
    white: White
    #: (y, x) pixels that all bands see unmasked.
    complete: NDArray[np.bool_]
    #: (y, x) those of them on a surface.
    coloured: NDArray[np.bool_]
    #: (y, x) pixels that statistics count, one of each cell behind a mosaic.
    single: NDArray[np.bool_]
    #: (y, x) map of each colour difference; NaN where a pixel has no colour.
    maps: Mapping[str, NDArray[np.float64]]
    #: Statistics of the colour differences that noise alone gives.
    noise: Mapping[str, DifferenceStatistics]
    #: (y, x) relative difference of luminance.
    luminance_map: NDArray[np.float64]
    #: (y, x) variance of the luminance by noise.
    luminance_variance: NDArray[np.float64]

    @property
    def variables(self) -> dict[str, tuple]:
        """Colours and their differences as variables of a dataset."""
        image = ("y", "x")
        return {
            "xyz_measured": ((*image, "xyz"), self.xyz_measured),
            "xyz_rendered": ((*image, "xyz"), self.xyz_rendered),
            **{name: (image, values, {"units": COLOUR_DIFFERENCES[name].unit}) for name, values in self.maps.items()},
            "luminance_relative_difference": (image, self.luminance_map, {"units": "1"}),
        }


def pixel_colours(
    images: tuple[NDArray, NDArray, NDArray],
    used: NDArray[np.bool_],
    on_surface: NDArray[np.bool_],
    inner: NDArray[np.bool_],
    weights: NDArray[np.float64],
    lamp_xyz: ArrayLike,
    cell: tuple[int, int] | None,
) -> PixelColours:
    """Colours of photograph and rendering, their differences, and the noise of these.

    Parameters
    ----------
    images
        (band, y, x) signals of photograph and rendering, DN, and the variance of their difference, DN^2.
    used
        (band, y, x) samples that are used.
    on_surface
        (y, x) pixels that see a surface.
    inner
        (y, x) pixels away from edges.
    weights
        (3, band) X, Y, Z per count.
    lamp_xyz
        (3,) X, Y, Z of the lamp in any scale.
    cell
        (height, width) of one repeat of the sensor's mosaic, px; None without a mosaic.

    Returns
    -------
    PixelColours
        Colours of pixels, or of the cells that they lie in behind a mosaic.
    """
    if cell is None:
        complete: NDArray[np.bool_] = np.asarray(used.all(axis=0))
        photograph, model, variance = images
    else:
        cells = [cell_means(image, images[2], used, cell) for image in images[:2]]
        complete = cells[0].complete
        photograph, model, variance = cells[0].signal, cells[1].signal, cells[0].variance
    coloured = complete & on_surface
    single = coloured if cell is None else one_pixel_of_each_cell(coloured, cell)
    xyz_photograph = np.einsum("cb,byx->yxc", weights, photograph)
    xyz_model = np.einsum("cb,byx->yxc", weights, model)
    # pixels at the lamp's edge would make it as bright as the picture is coarse
    bright = next(pixels for pixels in (coloured & inner, coloured, on_surface) if pixels.any())
    white = white_of(lamp_xyz, xyz_model[bright, 1])
    lab_photograph, lab_model = lab(xyz_photograph, white), lab(xyz_model, white)
    blank = np.where(coloured, 0.0, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = xyz_photograph[..., 1] / xyz_model[..., 1]
        luminance_map = blank + np.where(xyz_model[..., 1] > 0, ratio - 1.0, np.nan)
    return PixelColours(
        xyz_photograph,
        xyz_model,
        white,
        complete,
        coloured,
        single,
        {name: blank + d.between(lab_photograph, lab_model) for name, d in COLOUR_DIFFERENCES.items()},
        expected_from_noise(model[:, single], np.sqrt(variance[:, single]), weights, white, NOISE_SEED),
        luminance_map,
        np.einsum("b,byx->yx", weights[1] ** 2, variance),
    )
