"""Simulated captures of a spectral cube: frames, darks, flats (capture format, version 1)."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr
from cboxlab.calibration.capture import checked_pattern
from cboxlab.calibration.instrument import lens_constant, quanta_per_joule
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing_folder
from numpy.typing import NDArray

from ..files import scene_white, write_dng, write_raw
from ..sensor import SensorCamera, auto_exposure, frame_shape, simulate_frame
from .capture_writer import toml_table

__all__ = ["uniform_cube", "write_cube_capture"]

#: Frames of each exposure.
REPEATS = 2

#: Stated as focal length and image distance; the signals depend only on the camera's working f-number.
NOMINAL_FOCAL_MM = 50.0

#: Name of the frames of a camera with mosaic, which has no filter.
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
    folder: Path,
    cube: xr.Dataset,
    camera: SensorCamera,
    exposure_s: float | None,
    seed: int,
    scene: str,
    frames_as: Literal["tif", "dng"] = "tif",
) -> None:
    """Write repeated frames of a cube, flats of its white, and darks for every exposure.

    A camera without mosaic takes one band per channel. One with mosaic takes frames of all channels. These stand in one
    band for each channel.

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
    frames_as
        Format of the frames: "dng" as a camera's raw files, which state exposure, black and white level.

    Raises
    ------
    InputError
        If the folder is not empty, or the camera has a static nonlinearity: the format requires linear counts. If the
        mosaic is larger than the format allows, and as ``simulate``.
    """
    if camera.detector.linear_dn is not None:
        raise InputError(f"camera {camera.name}", "a static nonlinearity", "linear counts, for a capture")
    pattern = None if camera.pattern is None else _pattern(camera)
    shape = frame_shape(cube)
    field = uniform_cube(scene_white(cube), shape)
    filters: dict[str, str | None] = {name: name for name in camera.channels} if pattern is None else {_OPEN: None}
    seeds = iter(np.random.SeedSequence(seed).generate_state(8 * len(filters) * REPEATS).tolist())
    frames: dict[str, tuple[NDArray[np.uint16], float]] = {}
    tables, exposures, white = [], set(), scene_white(cube)

    def photograph(source: xr.Dataset, name: str, channel: str | None, seconds: float) -> list[str]:
        paths = [f"frames/{name}-{repeat}.{frames_as}" for repeat in range(REPEATS)]
        for path in paths:
            frames[path] = simulate_frame(source, camera, seconds, next(seeds), channel), seconds
        return paths

    optics = {"f_number": camera.f_number, "image_distance_mm": NOMINAL_FOCAL_MM}
    with replacing_folder(folder) as temporary:
        for kind, source in (("band", cube), ("flat", field)):
            for band, channel in filters.items():
                seconds = exposure_s if kind == "band" else None
                seconds = seconds or _rounded(auto_exposure(source, camera, channel))
                exposures.add(seconds)
                name = band if kind == "band" else f"flat-{band}"
                paths = photograph(source, name, channel, seconds)
                for letter in camera.channels if channel is None else [None]:
                    identifier = band if letter is None else _band_id(letter, camera)
                    entries: dict[str, object] = {"band": identifier}
                    if kind == "band":
                        column = f"spectra/channels.csv:{channel or 'one'}"
                        entries = {"id": identifier, "channel": letter, "transmittance": column}
                    tables.append(toml_table(f"[[{kind}]]", **entries, frames=paths, exposure_s=seconds, **optics))
        first_channel = next(iter(filters.values()))
        curve = next(iter(camera.channels.values()))
        black = uniform_cube(Spectrum(curve.wavelength_nm, np.zeros(curve.values.size), "zero"), shape)
        for seconds in sorted(exposures):
            paths = photograph(black, f"dark-{seconds:g}s", first_channel, seconds)
            tables.append(toml_table("[[dark]]", frames=paths, exposure_s=seconds))
        for path, (counts, seconds) in frames.items():
            if frames_as == "dng":
                write_dng(temporary / path, counts, camera, seconds, white)
            else:
                write_raw(temporary / path, counts)
        _write_channels(temporary / "spectra" / "channels.csv", camera)
        head = _head(camera, scene, shape, min(exposures), pattern)
        (temporary / "capture.toml").write_text("\n".join([*head, *tables]), encoding="utf-8")


def _pattern(camera: SensorCamera) -> str:
    """The mosaic in the spelling of the capture format; InputError for another kind."""
    rows = camera.pattern or ()
    is_small = [len(row) for row in rows] == [2, 2]
    try:
        return checked_pattern("".join(rows) if is_small else " ".join(rows))
    except ValueError as fault:
        raise InputError(f"camera {camera.name}: mosaic", repr(list(rows)), str(fault)) from None


def _band_id(channel: str, camera: SensorCamera) -> str:
    """Identifier of a channel's band: its letter, in lower case where this is unambiguous."""
    lower = {letter.lower() for letter in camera.channels}
    return channel.lower() if len(lower) == len(camera.channels) else channel


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


def _head(
    camera: SensorCamera, scene: str, shape: tuple[int, int], shortest_s: float, pattern: str | None
) -> list[str]:
    """Tables of a manifest in front of those of the frames."""
    detector = camera.detector
    column = "spectra/channels.csv:{}".format
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
            quantum_efficiency=column("one") if pattern is None else None,
        ),
        toml_table("[lens]", focal_length_mm=NOMINAL_FOCAL_MM, transmittance=column("one")),
    ]
    if pattern is not None:
        channels = {letter: column(letter) for letter in camera.channels}
        parts.insert(2, toml_table("[camera.quantum_efficiency]", **channels))
        parts.append(toml_table("[mosaic]", pattern=pattern))
    return parts
