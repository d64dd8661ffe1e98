"""The command hyperspectral: from a capture with many filters to a spectral cube."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from cboxlab.utils.errors import InputError

from .arguments import JsonOption
from .console import bar, data_table, give_json, print_table, say

if TYPE_CHECKING:
    from cboxlab.calibration.radiometry import HyperspectralCube
    from cboxlab.scenes.spectra import Spectrum

__all__ = ["hyperspectral"]


def hyperspectral(
    capture: Annotated[
        Path,
        typer.Argument(help="A folder of the capture format with a [[band]] per filter.", show_default=False),
    ],
    reading: Annotated[
        str,
        typer.Option(
            help="Reading of the spectroradiometer, W m^-2 sr^-1 nm^-1: FILE.csv:COLUMN, first column wavelength_nm.",
            show_default=False,
        ),
    ],
    region: Annotated[
        str,
        typer.Option(
            help="Measured region: u0,v0,u1,v1 (pixels, both corners included) or the name of a label in [labels].",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Spectral cube: .nc, .exr or .hdr.")] = Path("cube.nc"),
    reference_band: Annotated[
        str | None, typer.Option(help="Band to which the others are registered; default the middle one.")
    ] = None,
    unaligned: Annotated[bool, typer.Option("--unaligned", help="Do not register the bands.")] = False,
    scene: Annotated[
        bool, typer.Option("--scene", help="For cbox simulate: fill masked pixels, set negative values to 0.")
    ] = False,
    *,
    json: JsonOption = None,
) -> None:
    """A spectral cube from a camera with many filters and one spectroradiometer reading."""
    from cboxlab.calibration.capture import band_channels, load_capture
    from cboxlab.calibration.correction import correct_bands, measure_noise, read_darks, with_full_well
    from cboxlab.calibration.radiometry import as_scene, hyperspectral_cube, region_mask
    from cboxlab.rendering.files import WRITABLE, files_of, write_cube
    from cboxlab.utils.files import origin

    from ...api import write_manifest

    if out.suffix.lower() not in set(WRITABLE) - {".png"}:
        raise InputError("--out", f"'{out}'", "a cube's file name, ending in .nc, .exr or .hdr")
    loaded, spectrum = with_full_well(load_capture(capture)), _reading(reading)
    if loaded.manifest.mosaic is not None:
        raise InputError(capture / "capture.toml", "a sensor with a mosaic", "a monochrome sensor")
    inside = region_mask(loaded, region)
    with bar("calibrating"):
        dark = read_darks(loaded)
        noise = measure_noise(loaded, dark)
        bands = correct_bands(loaded, dark, noise, band_channels(loaded))
        found = hyperspectral_cube(
            loaded, bands, inside, spectrum, reference_band=reference_band, aligned=not unaligned
        )
    made = (as_scene(found.cube) if scene else found.cube).assign_attrs(origin(capture=str(capture)))
    write_cube(out, made)
    write_manifest(out, files_of(out), [capture, Path(reading.rpartition(":")[0])])
    _print_bands(found)
    for note in dict.fromkeys((*noise.notes, *bands.notes, *found.notes)):
        say(f"• {note}")
    give_json(
        json,
        {
            "cube": out,
            "bands": list(found.bands),
            "wavelength_nm": found.cube["wavelength"].values.tolist(),
            "scale": found.scale.tolist(),
            "scale_relative_sigma": found.scale_relative_sigma.tolist(),
            "notes": list(found.notes),
        },
    )
    say(f"Cube: {out} ({len(found.bands)} bands, {int(inside.sum())} pixels of the region)")


def _reading(reference: str) -> Spectrum:
    from cboxlab.scenes.spectra import read_spectrum

    name, _, column = reference.rpartition(":")
    if not name or not column:
        raise InputError("--reading", f"'{reference}'", "a column of a file, such as reading.csv:radiance")
    path = Path(name)
    return read_spectrum(path.parent, f"{path.name}:{column}", "zero")


def _print_bands(found: HyperspectralCube) -> None:
    table = data_table(
        f"Bands, registered to {found.cube.attrs['registered_to']}",
        "band",
        "nm",
        "L per DN",
        "± 1 σ, %",
        "u, px",
        "v, px",
        "size",
        "correlation",
    )
    rows = zip(
        found.bands,
        found.cube["wavelength"].values,
        found.scale,
        found.scale_relative_sigma,
        found.registrations,
        strict=True,
    )
    for band, wavelength, scale, sigma, moved in rows:
        shift = moved.shift_px.round(2) + 0.0  # no -0.00
        table.add_row(
            band,
            f"{wavelength:.1f}",
            f"{scale:.4g}",
            f"{100 * sigma:.2f}",
            f"{shift[0]:+.2f}",
            f"{shift[1]:+.2f}",
            f"{moved.magnification:.4f}",
            f"{moved.correlation:.3f}",
        )
    print_table(table)
