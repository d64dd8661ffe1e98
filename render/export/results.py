"""Exports for all renderers, and the cubes of the renderings that came back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing_folder
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ..files import NOTES, camera_attribute
from ..image import LAMP, NOTHING
from .neutral import (
    Exported,
    Layout,
    has_export,
    read_camera,
    read_layout,
    read_surfaces,
    read_warp,
    write_neutral,
)
from .renderers import renderer_catalogue, renderer_of

__all__ = ["as_rendered", "read_rendered", "write_export"]


def write_export(folder: Path, exported: Exported) -> None:
    """Write the renderer-neutral files and one folder for each renderer of the catalogue.

    The export is complete or not written at all. A folder that holds the same export already keeps what renderers have
    written there. Renderers that joined the catalogue since then get their folders.

    Parameters
    ----------
    folder
        A new folder, or one with the same export.
    exported
        The export.

    Raises
    ------
    InputError
        If ``folder`` holds anything else, or if the scene cannot be exported.
    """
    renderers = renderer_catalogue()
    if has_export(folder, exported):
        for identifier, renderer in renderers.items():
            if not (folder / identifier).exists():
                with replacing_folder(folder / identifier) as temporary:
                    renderer.write(temporary, exported)
        return
    with replacing_folder(folder) as temporary:
        write_neutral(temporary, exported)
        for identifier, renderer in renderers.items():
            (temporary / identifier).mkdir()
            renderer.write(temporary / identifier, exported)


def as_rendered(exported: Exported, renderer: str) -> Exported:
    """Export as a renderer shows it: with black lamps where its lamps cannot reflect.

    Parameters
    ----------
    exported
        The export.
    renderer
        Identifier of the renderer.

    Returns
    -------
    Exported
        ``exported`` itself, or the same with black lamps.

    Raises
    ------
    InputError
        If the renderer is unknown.
    """
    same = renderer_of(renderer).lamp_reflects or not exported.lamp_reflects
    return exported if same else exported.with_black_lamps


def read_rendered(folder: Path, renderer: str) -> xr.Dataset:
    """Cube of the renderings that one renderer wrote into an export.

    Parameters
    ----------
    folder
        The export.
    renderer
        Identifier of the renderer.

    Returns
    -------
    Dataset
        ``radiance`` (y, x, wavelength), its ``standard_error`` from the scatter of the batches, and ``surface``, the
        surface that each pixel sees. A note says where the renderer's lamps do not reflect and those of the scene do.

    Raises
    ------
    InputError
        If the renderer is unknown, or its renderings are missing, of another size, or not finite.
    """
    known_renderer = renderer_of(renderer)
    folder = Path(folder)
    layout = read_layout(folder)
    pixels = known_renderer.read(folder / renderer, layout)
    if not np.isfinite(pixels).all():
        raise InputError(folder / renderer, "pixels that are not finite", "finite radiances")
    over_rays = known_renderer.pixels == "rays"
    batches = _mean_over_rays(pixels, layout) if over_rays else _camera_pixels(pixels, layout, folder)
    cube = _cube(batches, layout, *read_surfaces(folder))
    cube.attrs["camera"] = camera_attribute(read_camera(folder / "camera.json"))
    if layout.lamp_reflects and not known_renderer.lamp_reflects:
        return cube.assign_attrs({NOTES: f"lamps of {known_renderer.name} reflect nothing, that of the scene does"})
    return cube


def _mean_over_rays(pixels: NDArray, layout: Layout) -> NDArray[np.float64]:
    """(batch, y, x, w) means over the s x s rays of each pixel."""
    s, count = layout.settings.subpixels, layout.settings.batches
    parts = pixels.reshape(count, layout.height_px, s, layout.width_px, s, layout.channels)
    return np.asarray(parts.mean(axis=(2, 4), dtype=np.float64))


def _camera_pixels(pixels: NDArray, layout: Layout, folder: Path) -> NDArray[np.float64]:
    """(batch, y, x, w) means over the camera's pixels from those of the film."""
    warp = read_warp(folder)
    shape = layout.height_px, layout.width_px, layout.channels
    if warp is None:
        return np.asarray(pixels, np.float64)
    row, column, weight = warp
    sizes = layout.height_px * layout.width_px, layout.film_height_px * layout.film_width_px
    matrix = csr_array((weight, (row, column)), shape=sizes)
    return np.stack([(matrix @ batch.reshape(sizes[1], -1)).reshape(shape) for batch in pixels])


def _cube(
    batches: NDArray[np.float64], layout: Layout, surface: NDArray[np.int16], names: tuple[str, ...]
) -> xr.Dataset:
    """Mean of the batches, its standard error, and the map of surfaces."""
    unit = {"units": "W m^-2 sr^-1 nm^-1"}
    error = batches.std(axis=0, ddof=1) / np.sqrt(len(batches))
    dims = ("y", "x", "wavelength")
    return xr.Dataset(
        {
            "radiance": (dims, batches.mean(axis=0).astype(np.float32), unit),
            "standard_error": (dims, error.astype(np.float32), {**unit, "batches": len(batches)}),
            "surface": (("y", "x"), surface, {"names": ", ".join(names), "lamp": LAMP, "nothing": NOTHING}),
        },
        coords={"wavelength": ("wavelength", layout.settings.wavelength_nm, {"units": "nm"})},
    )
