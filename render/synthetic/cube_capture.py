"""Simulated captures of a spectral cube: frames, darks, flats (capture format, version 1)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.calibration.instrument import lens_constant, quanta_per_joule
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing_folder
from numpy.typing import NDArray

from ..files import scene_white, write_raw
from ..sensor import SensorCamera, auto_exposure, frame_shape, simulate
from .capture_writer import toml_table

__all__ = ["uniform_cube", "write_cube_capture"]

#: Frames of each exposure.
REPEATS = 2

#: Stated as focal length and image distance; the signals depend only on the camera's working f-number.
NOMINAL_FOCAL_MM = 50.0

#: Name of the single band of a camera with mosaic.
_OPEN = "open"


def uniform_cube(spectrum: Spectrum, shape: tuple[int, int]) -> xr.Dataset:
    """Cube with the same spectrum in all pixels, in the memory of one pixel.

    Parameters
    ----------
    spectrum
        Radiance.
    shape
        Rows and columns.

    Returns
    -------
    xr.Dataset
        ``radiance`` (y, x, wavelength).
    """
    radiance = np.broadcast_to(spectrum.values, (*shape, spectrum.values.size))
    return xr.Dataset({"radiance": (("y", "x", "wavelength"), radiance)}, coords={"wavelength": spectrum.wavelength_nm})


def write_cube_capture(
    folder: Path, cube: xr.Dataset, camera: SensorCamera, exposure_s: float | None, seed: int, scene: str
) -> None:
    """Write repeated frames of a cube, flats of its white, and darks for every exposure.

    A camera without mosaic takes one band per channel, one with mosaic a single band "open".

    Parameters
    ----------
    folder
        Folder to write; an incomplete one is removed.
    cube
        Radiance (y, x, wavelength), or coefficients of a spectral basis.
    camera
        The camera.
    exposure_s
        Exposure of the scene, s; None chooses one per band.
    seed
        Seed of all random numbers.
    scene
        Name of the scene in the manifest.

    Raises
    ------
    InputError
        If the folder is not empty, or the camera has a static nonlinearity: the format requires linear counts. If the
        format does not support the mosaic, and as ``simulate``.
    """
    if camera.detector.linear_dn is not None:
        raise InputError(f"camera {camera.name}", "a static nonlinearity", "linear counts, for a capture")
    rows = camera.pattern
    if rows is not None and ([len(row) for row in rows] != [2, 2] or set(camera.channels) != set("RGB")):
        raise InputError(f"camera {camera.name}: mosaic", repr(list(rows)), "2 x 2 letters R, G, B, or none")
    shape = frame_shape(cube)
    field = uniform_cube(scene_white(cube), shape)
    bands: dict[str, str | None] = {_OPEN: None} if rows else {name: name for name in camera.channels}
    seeds = iter(np.random.SeedSequence(seed).generate_state(8 * len(bands) * REPEATS).tolist())
    frames: dict[str, NDArray[np.uint16]] = {}
    tables, exposures = [], set()

    def photograph(source: xr.Dataset, name: str, channel: str | None, seconds: float) -> list[str]:
        paths = [f"frames/{name}-{repeat}.tif" for repeat in range(REPEATS)]
        for path in paths:
            frames[path] = simulate(source, camera, seconds, next(seeds), channel)
        return paths

    optics = {"f_number": camera.f_number, "image_distance_mm": NOMINAL_FOCAL_MM}
    with replacing_folder(folder) as temporary:
        for kind, source in (("band", cube), ("flat", field)):
            for band, channel in bands.items():
                seconds = exposure_s if kind == "band" else None
                seconds = seconds or _rounded(auto_exposure(source, camera, channel))
                exposures.add(seconds)
                name = band if kind == "band" else f"flat-{band}"
                paths = photograph(source, name, channel, seconds)
                entries: dict[str, object] = {"id": band} if kind == "band" else {"band": band}
                if kind == "band":
                    entries["transmittance"] = f"spectra/channels.csv:{channel or 'one'}"
                tables.append(toml_table(f"[[{kind}]]", **entries, frames=paths, exposure_s=seconds, **optics))
        first_channel = next(iter(bands.values()))
        curve = next(iter(camera.channels.values()))
        black = uniform_cube(Spectrum(curve.wavelength_nm, np.zeros(curve.values.size), "zero"), shape)
        for seconds in sorted(exposures):
            paths = photograph(black, f"dark-{seconds:g}s", first_channel, seconds)
            tables.append(toml_table("[[dark]]", frames=paths, exposure_s=seconds))
        for path, counts in frames.items():
            write_raw(temporary / path, counts)
        _write_channels(temporary / "spectra" / "channels.csv", camera)
        head = _head(camera, scene, shape, min(exposures))
        (temporary / "capture.toml").write_text("\n".join([*head, *tables]), encoding="utf-8")


def _rounded(seconds: float) -> float:
    """Seconds with two digits."""
    return float(f"{seconds:.2g}")


def _write_channels(path: Path, camera: SensorCamera) -> None:
    """Write the quantum efficiencies, which include lens and filter, and a column of ones."""
    path.parent.mkdir()
    grid = next(iter(camera.channels.values())).wavelength_nm
    collected = lens_constant(1.0, camera.pixel_pitch_um, 1.0) / camera.f_number**2 * quanta_per_joule(grid)
    columns = {name: curve.at(grid) / collected for name, curve in camera.channels.items()}
    rows = np.column_stack([grid, np.ones(grid.size), *columns.values()])
    header = ",".join(["wavelength_nm", "one", *columns])
    np.savetxt(path, rows, "%.8g", ",", header=header, comments="")


def _head(camera: SensorCamera, scene: str, shape: tuple[int, int], shortest_s: float) -> list[str]:
    """Tables of a manifest in front of those of the frames."""
    detector = camera.detector
    column = "spectra/channels.csv:{}".format
    efficiency = column("one") if camera.pattern is None else [column(letter) for letter in "RGB"]
    parts = [
        toml_table("", format="capture/1", name=f"{scene} by {camera.name}", scene=scene),
        toml_table(
            "[camera]",
            model=camera.name,
            width_px=shape[1],
            height_px=shape[0],
            pixel_pitch_um=camera.pixel_pitch_um,
            bit_depth=detector.bit_depth,
            gain_e_per_dn=detector.gain_e_per_dn,
            read_noise_e=detector.dark(shortest_s)[1] * detector.gain_e_per_dn,
            quantum_efficiency=efficiency,
        ),
        toml_table("[lens]", focal_length_mm=NOMINAL_FOCAL_MM, transmittance=column("one")),
    ]
    if camera.pattern is not None:
        parts.append(toml_table("[mosaic]", pattern="".join(camera.pattern)))
    return parts
