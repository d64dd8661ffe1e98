"""``cbox hyperspectral``: spectral cube of a capture with many filters."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from cboxlab.utils.errors import InputError

from .arguments import JsonOption
from .console import bar, give_json, print_result, require_file, say

if TYPE_CHECKING:
    from cboxlab.scenes.spectra import Spectrum

__all__ = ["hyperspectral"]


def hyperspectral(
    capture: Annotated[
        Path,
        typer.Argument(help="Folder of a capture, with a [[band]] per filter in capture.toml.", show_default=False),
    ],
    reading: Annotated[
        str,
        typer.Option(
            help="Reading of the spectroradiometer, W m^-2 sr^-1 nm^-1, as FILE.csv:COLUMN. The first column is "
            "wavelength_nm.",
            show_default=False,
        ),
    ],
    region: Annotated[
        str,
        typer.Option(
            help="Region of the reading: u0,v0,u1,v1 in pixels, both corners included, or a name in [labels].",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="File of the spectral cube (.nc, .exr or .hdr).")] = Path("cube.nc"),
    reference_band: Annotated[
        str | None, typer.Option(help="Band to which the others are registered. The default is the middle band.")
    ] = None,
    unaligned: Annotated[bool, typer.Option("--unaligned", help="Do not register the bands.")] = False,
    scene: Annotated[
        bool, typer.Option("--scene", help="Fill masked pixels and set negative values to 0, for `cbox simulate`.")
    ] = False,
    *,
    json: JsonOption = None,
) -> None:
    """Make a spectral cube from a capture with many filters and one spectroradiometer reading."""
    from cboxlab.calibration.capture import band_channels, load_capture
    from cboxlab.calibration.correction import correct_bands, measure_noise, read_darks, with_full_well
    from cboxlab.calibration.radiometry import as_scene, hyperspectral_cube, region_mask
    from cboxlab.rendering.files import WRITABLE, files_of, write_cube
    from cboxlab.utils.files import origin

    from ...api import write_manifest

    if out.suffix.lower() not in set(WRITABLE) - {".png"}:
        raise InputError("--out", f"'{out}'", "a file name that ends in .nc, .exr or .hdr")
    require_file(out)
    loaded, spectrum = with_full_well(load_capture(capture)), _reading(reading)
    if loaded.manifest.mosaic is not None:
        raise InputError(capture / "capture.toml", "a sensor with a mosaic", "a monochrome sensor")
    inside = region_mask(loaded, region)
    with bar("calibrating"):
        dark = read_darks(loaded)
        noise = measure_noise(loaded, dark)
        bands = correct_bands(loaded, dark, noise, band_channels(loaded))
        result = hyperspectral_cube(
            loaded, bands, inside, spectrum, reference_band=reference_band, aligned=not unaligned
        )
    cube = (as_scene(result.cube) if scene else result.cube).assign_attrs(origin(capture=str(capture)))
    write_cube(out, cube)
    write_manifest(out, files_of(out), [capture, Path(reading.rpartition(":")[0])])
    lines = dict.fromkeys((*result.lines(), *(f"• {note}" for note in (*noise.notes, *bands.notes))))
    print_result(lines, result.tables())
    give_json(
        json,
        {
            "cube": out,
            "bands": list(result.bands),
            "wavelength_nm": result.cube["wavelength"].values.tolist(),
            "scale": result.scale.tolist(),
            "scale_relative_sigma": result.scale_relative_sigma.tolist(),
            "notes": list(result.notes),
        },
    )
    say(f"Cube, scaled by {int(inside.sum())} pixels of the region: {out}")


def _reading(reference: str) -> Spectrum:
    """Spectrum of the reading, zero beyond its wavelengths."""
    from cboxlab.scenes.spectra import read_spectrum

    name, _, column = reference.rpartition(":")
    if not name or not column:
        raise InputError("--reading", f"'{reference}'", "a column of a file, such as reading.csv:radiance")
    path = Path(name)
    return read_spectrum(path.parent, f"{path.name}:{column}", "zero")
