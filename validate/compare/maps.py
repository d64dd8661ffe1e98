"""Maps as multi-channel OpenEXR files (32-bit float) and PNG previews, with units in the header."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import OpenEXR
import xarray as xr
from cboxlab.rendering.files import write_channels
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
    """Write (channel, y, x) as one scanline EXR of 32-bit floats; NaN stays NaN.

    units : of each channel; written to the header as ``cbox.unit.<channel>``. The order of the channels, which
    OpenEXR sorts by name, stands there as ``cbox.channels``, attributes of the array as ``cbox.<name>``.
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
    """A map written by ``write_map``: float32 (channel, y, x) with its attributes, and the units by channel.

    Any other EXR reads too: channels in the file's order, no units. Raises InputError where it is no EXR.
    """
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            # The file empties its header and channels when it is closed.
            header = dict(file.header())
            stored = {name: np.array(c.pixels, np.float32) for name, c in file.channels().items()}
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(path, str(error) or "no readable file", "an OpenEXR file") from None
    own = {k.removeprefix(PREFIX): v for k, v in header.items() if k.startswith(PREFIX)}
    names = own.pop("channels").split("\n") if "channels" in own else list(stored)
    units = {name: own.pop("unit." + name, "") for name in names}
    values = np.stack([stored[name] for name in names])
    return xr.DataArray(values, dims=("channel", "y", "x"), coords={"channel": names}, attrs=own), units


def _write_png(path: Path, rgb: NDArray[np.uint8]) -> None:
    with replacing(path) as temporary:
        Image.fromarray(rgb).save(temporary, format="PNG", optimize=True)


def write_maps(
    folder: Path, comparison: Comparison, origin: Mapping[str, str], xyz_unit: str = "cd m^-2"
) -> list[Path]:
    """Write every map of a comparison into ``folder``; returns the paths.

    origin : attributes of every file, such as the model, the seed, the program's version and the command.

    measured.exr, rendered.exr, sigma.exr (DN, a channel per band), residual_over_sigma.exr, mask.exr (sum of
    flags), xyz_measured.exr, xyz_rendered.exr (in ``xyz_unit``), difference.exr (dX, dY, dZ as measured minus
    rendered, dY_relative, dE76, dE2000), regions.exr (surface index, -1 none; edge_distance_px), and
    measured.png, rendered.png: sRGB at one common exposure, adapted from the lamp's white.
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
