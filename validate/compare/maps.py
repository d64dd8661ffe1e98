"""Maps of a comparison as OpenEXR files with units in the header, and PNG previews."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import OpenEXR
import xarray as xr
from cboxlab.rendering.files import require_exr_size, write_channels
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from .colour_difference import COLOUR_DIFFERENCES, HEADLINE, srgb_preview
from .comparison import Comparison

__all__ = ["read_map", "write_map", "write_maps"]

#: Prefix of the program's header attributes, to avoid collisions with those of OpenEXR.
PREFIX = "cbox."


def write_map(path: Path, channels: xr.DataArray, units: Mapping[str, str]) -> None:
    """Write an array as one scanline EXR of 32-bit floats; NaN stays NaN.

    The header holds the units as ``cbox.unit.<channel>`` and attributes of the array as ``cbox.<name>``. OpenEXR sorts
    channels by name; the header holds their order as ``cbox.channels``.

    Parameters
    ----------
    path
        File to write.
    channels
        (channel, y, x) values with the names of the channels.
    units
        Unit of each channel.
    """
    names = [str(name) for name in channels["channel"].values]
    header = {
        PREFIX + "channels": "\n".join(names),
        **{PREFIX + "unit." + name: units[name] for name in names},
        **{PREFIX + str(key): str(value) for key, value in channels.attrs.items()},
    }
    pixels = {name: np.ascontiguousarray(channels.values[index], np.float32) for index, name in enumerate(names)}
    write_channels(path, header, pixels)


def read_map(path: Path) -> tuple[xr.DataArray, dict[str, str]]:
    """Read a map written by ``write_map``, or any other EXR.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    DataArray
        float32 (channel, y, x) with its attributes; channels of other files in the file's order.
    dict
        Units by channel, empty texts for other files.

    Raises
    ------
    InputError
        If the file is no readable EXR.
    """
    try:
        require_exr_size(path)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            # The file empties its header and channels when it is closed.
            header = dict(file.header())
            stored = {name: np.array(c.pixels, np.float32) for name, c in file.channels().items()}
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(path, str(error) or "no readable file", "an OpenEXR file") from None
    attributes = {k.removeprefix(PREFIX): v for k, v in header.items() if k.startswith(PREFIX)}
    names = attributes.pop("channels").split("\n") if "channels" in attributes else list(stored)
    units = {name: attributes.pop("unit." + name, "") for name in names}
    values = np.stack([stored[name] for name in names])
    return xr.DataArray(values, dims=("channel", "y", "x"), coords={"channel": names}, attrs=attributes), units


def _write_png(path: Path, rgb: NDArray[np.uint8]) -> None:
    with replacing(path) as temporary:
        Image.fromarray(rgb).save(temporary, format="PNG", optimize=True)


def write_maps(
    folder: Path, comparison: Comparison, origin: Mapping[str, str], xyz_unit: str = "cd m^-2"
) -> list[Path]:
    """Write every map of a comparison.

    measured.exr, rendered.exr and sigma.exr have a channel per band, in DN; residual_over_sigma.exr and mask.exr (sum
    of flags) also. xyz_measured.exr and xyz_rendered.exr are in ``xyz_unit``. difference.exr holds dX, dY, dZ as
    measured minus rendered, dY_relative, and a channel for each colour difference. regions.exr holds the index of the
    surface (-1 for none) and the distance from edges. measured.png and rendered.png are sRGB at one common exposure,
    adapted from the lamp's white.

    Parameters
    ----------
    folder
        Existing folder for the files.
    comparison
        The comparison.
    origin
        Attributes of every file, such as the model, the seed, the program's version and the command.
    xyz_unit
        Unit of X, Y, Z.

    Returns
    -------
    list
        Paths of the files.
    """
    maps, bands = comparison.maps, comparison.bands
    written = []

    def save(name: str, channels: list[str], values: ArrayLike, units: list[str], description: str) -> None:
        array = xr.DataArray(
            np.asarray(values),
            dims=("channel", "y", "x"),
            coords={"channel": channels},
            attrs={"description": description, **origin},
        )
        write_map(folder / name, array, dict(zip(channels, units, strict=True)))
        written.append(folder / name)

    per_band = {
        "measured": ("DN", "band signals after dark and flat correction"),
        "rendered": ("DN", "band signals of the render at the exposure of the measurement"),
        "sigma": ("DN", "standard deviation of measured minus rendered: sensor and Monte Carlo noise"),
        "residual_over_sigma": ("1", "(measured - rendered) / sigma; NaN where the pixel is left out"),
        "mask": (
            maps["mask"].attrs.get("flags", ""),
            "reasons for leaving out a pixel, sum of flags; 0: used",
        ),
    }
    for name, (unit, text) in per_band.items():
        save(f"{name}.exr", list(bands), maps[name].values, [unit] * len(bands), text)
    measured, rendered = (np.moveaxis(maps[f"xyz_{which}"].values, -1, 0) for which in ("measured", "rendered"))
    text = "CIE 1931 2-degree XYZ through the filter weights"
    save("xyz_measured.exr", list("XYZ"), measured, [xyz_unit] * 3, text)
    save("xyz_rendered.exr", list("XYZ"), rendered, [xyz_unit] * 3, text)
    colours = [COLOUR_DIFFERENCES[name] for name in comparison.colour]
    luminance = maps["luminance_relative_difference"].values
    save(
        "difference.exr",
        ["dX", "dY", "dZ", "dY_relative", *(d.channel for d in colours)],
        # the map of a colour difference is NaN where a pixel is left out
        [*(measured - rendered + 0 * maps[HEADLINE.id].values), luminance, *(maps[d.id].values for d in colours)],
        [xyz_unit] * 3 + ["1"] + [d.unit for d in colours],
        "measured minus rendered; dY_relative is (measured - rendered) / rendered; NaN where left out",
    )
    names = ", ".join(f"{i}={name}" for i, name in enumerate(maps.attrs["surface_names"]))
    save(
        "regions.exr",
        ["surface", "edge_distance_px"],
        [maps["surface"].values, maps["edge_distance_px"].values],
        [names, "px"],
        "surface seen by a pixel, and distance to its nearest edge",
    )
    for which in ("measured", "rendered"):
        path = folder / f"{which}.png"
        _write_png(path, srgb_preview(maps[f"xyz_{which}"].values, comparison.white))
        written.append(path)
    return written
