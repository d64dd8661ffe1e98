"""The renderers that a box is exported for, and what each wrote as a cube."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import suggestion
from cboxlab.utils.files import replacing_folder
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ..files import NOTES, camera_attribute
from ..image import LAMP, NOTHING
from . import luxcore, mitsuba, pbrt, radiance, raysect
from .camera_file import read_camera
from .exported import Exported, Layout
from .neutral import holds, read_layout, read_surfaces, read_warp, write_neutral

__all__ = ["FORMATS", "RendererFormat", "as_rendered", "read_rendered", "write_export"]


@dataclass(frozen=True)
class RendererFormat:
    """One renderer. command : what renders, run in its folder; {python} stands for an interpreter.

    read : its pictures as (batch, y, x, w), of the film's pixels or, where ``rays``, of subpixels. needs : what has to
    be installed. lamp_reflects : whether a lamp can.
    """

    name: str
    write: Callable[[Path, Exported], None]
    read: Callable[[Path, Layout], NDArray]
    command: tuple[str, ...]
    needs: str
    rays: bool
    lamp_reflects: bool = True


_PYTHON = ("{python}", "run.py")
#: By the name of the folder.
FORMATS: Mapping[str, RendererFormat] = MappingProxyType(
    {
        "mitsuba": RendererFormat("Mitsuba 3", mitsuba.write, mitsuba.read, _PYTHON, "the package mitsuba", False),
        "radiance": RendererFormat(
            "Radiance",
            radiance.write,
            radiance.read,
            ("sh", "run.sh"),
            "oconv and rtrace, or the package pyradiance",
            True,
            False,
        ),
        "raysect": RendererFormat("Raysect", raysect.write, raysect.read, _PYTHON, "the package raysect", True),
        "pbrt": RendererFormat("pbrt-v4", pbrt.write, pbrt.read, ("sh", "run.sh"), "pbrt (version 4)", False),
        "luxcore": RendererFormat(
            "LuxCoreRender", luxcore.write, luxcore.read, _PYTHON, "the package pyluxcore", False
        ),
    }
)


def write_export(folder: Path, exported: Exported) -> None:
    """Write the neutral part and one folder for each renderer; complete or not at all.

    A folder that holds the same export already stays as it is, with what renderers have written there. Raises
    InputError where ``folder`` holds anything else, or for what cannot be exported.
    """
    if holds(folder, exported):
        return
    with replacing_folder(folder) as temporary:
        write_neutral(temporary, exported)
        for name, known in FORMATS.items():
            (temporary / name).mkdir()
            known.write(temporary / name, exported)


def as_rendered(exported: Exported, renderer: str) -> Exported:
    """The export as one of FORMATS renders it: with black lamps where its lamps reflect nothing."""
    same = FORMATS[renderer].lamp_reflects or not exported.lamp_reflects
    return exported if same else exported.with_black_lamps


def read_rendered(folder: Path, renderer: str) -> xr.Dataset:
    """What one renderer wrote into an export, as a cube.

    folder : the export. renderer : one of FORMATS. The cube has radiance (y, x, wavelength), its standard_error from
    the scatter of the batches, and the surface that each pixel sees. Raises InputError for an unknown renderer, and
    for pictures that are missing, of another size, or not finite.
    """
    known = FORMATS.get(renderer)
    if known is None:
        raise InputError("renderer", f"'{renderer}'", f"one of {', '.join(FORMATS)}", suggestion(renderer, FORMATS))
    folder = Path(folder)
    layout = read_layout(folder)
    pictures = known.read(folder / renderer, layout)
    if not np.isfinite(pictures).all():
        raise InputError(folder / renderer, "pixels that are not finite", "finite radiances")
    batches = _over_subpixels(pictures, layout) if known.rays else _warped(pictures, layout, folder)
    cube = _cube(batches, layout, *read_surfaces(folder))
    cube.attrs["camera"] = camera_attribute(read_camera(folder / "camera.json"))
    if layout.lamp_reflects and not known.lamp_reflects:
        return cube.assign_attrs({NOTES: f"lamps of {known.name} reflect nothing, that of the scene does"})
    return cube


def _over_subpixels(pictures: NDArray, layout: Layout) -> NDArray[np.float64]:
    s, count = layout.settings.subpixels, layout.settings.batches
    parts = pictures.reshape(count, layout.height_px, s, layout.width_px, s, layout.channels)
    return np.asarray(parts.mean(axis=(2, 4), dtype=np.float64))


def _warped(pictures: NDArray, layout: Layout, folder: Path) -> NDArray[np.float64]:
    """Of the camera's pixels, from those of the film."""
    warp = read_warp(folder)
    shape = layout.height_px, layout.width_px, layout.channels
    if warp is None:
        return np.asarray(pictures, np.float64)
    row, column, weight = warp
    pixels = layout.height_px * layout.width_px, layout.film_height_px * layout.film_width_px
    matrix = csr_array((weight, (row, column)), shape=pixels)
    return np.stack([(matrix @ p.reshape(pixels[1], -1)).reshape(shape) for p in pictures])


def _cube(
    batches: NDArray[np.float64], layout: Layout, surface: NDArray[np.int16], names: tuple[str, ...]
) -> xr.Dataset:
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
