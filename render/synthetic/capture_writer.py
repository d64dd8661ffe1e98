"""Complete simulated captures of a box in files (capture format, version 1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import tomli_w
from cboxlab.calibration.instrument import ResponseFactors, lens_constant, response_factors, rest_curve
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.spectra import Spectrum, planck, read_spectra
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM, WavelengthGrid
from cboxlab.utils.files import replacing_folder
from numpy.typing import NDArray

from ..files import write_raw
from ..sensor import PACKAGED
from .mosaic_sensor import MosaicSensor, interleaved
from .photographer import CaptureSettings, FrameHooks, Shot, photograph, pixel_maps, plan_shots
from .survey import survey

__all__ = [
    "sphere_spectrum",
    "toml_table",
    "tungsten_lamp",
    "unit_factors",
    "write_photographs",
]


def tungsten_lamp(radiance_550: float = 8e-4, temperature_k: float = 3000.0) -> Spectrum:
    """Radiance of a tungsten lamp with a neutral diffuser (Planck's law), 400 to 700 nm.

    Parameters
    ----------
    radiance_550
        Radiance at 550 nm, W m^-2 sr^-1 nm^-1.
    temperature_k
        Temperature, K.

    Returns
    -------
    Spectrum
        W m^-2 sr^-1 nm^-1; 0 outside 400 to 700 nm.
    """
    return Spectrum(WAVELENGTH_NM, radiance_550 * planck(WAVELENGTH_NM, temperature_k), "zero")


def sphere_spectrum(brightness: float = 1.0) -> Spectrum:
    """Radiance of the integrating sphere: Planck's law at 2856 K.

    Parameters
    ----------
    brightness
        Factor; at 1 the sphere is about as bright as a wall of the box.

    Returns
    -------
    Spectrum
        W m^-2 sr^-1 nm^-1; 0 outside 400 to 700 nm.
    """
    return Spectrum(WAVELENGTH_NM, brightness * 1e-5 * planck(WAVELENGTH_NM, 2856.0), "zero")


@lru_cache
def _curves() -> dict[str, Spectrum]:
    return read_spectra(PACKAGED / "pxl1300l.csv", "zero")


def unit_factors(
    settings: CaptureSettings,
    width_px: int,
    grid: WavelengthGrid = INTEGRAL_GRID,
) -> ResponseFactors:
    """Responses of the bands for one second, factored: signals come in DN/s.

    Parameters
    ----------
    settings
        Camera, lens and filters.
    width_px
        Columns of a frame; the pixel pitch is the film width over it.
    grid
        Wavelengths of the responses.

    Returns
    -------
    ResponseFactors
        Responses on ``grid``.
    """
    filters = {band.id: settings.filters[band.filter] for band in settings.bands}
    efficiencies, lens = channel_efficiencies(settings.mosaic), _curves()["lens"]
    rests = [rest_curve(efficiencies[band.channel], lens, grid) for band in settings.bands]
    pitch_um = settings.film_width_mm * 1e3 / width_px
    constant = lens_constant(settings.focal_length_mm, pitch_um, settings.gain_e_per_dn)
    factor = constant / (settings.f_number * settings.image_distance_mm) ** 2
    return response_factors(filters, rests, [factor] * len(filters), grid)


def channel_efficiencies(mosaic: MosaicSensor | None) -> dict[str | None, Spectrum]:
    """Quantum efficiency of each channel: the sensor's, behind a mosaic times its dye.

    Parameters
    ----------
    mosaic
        The mosaic; None without one.

    Returns
    -------
    dict
        By letter; by None without a mosaic.
    """
    sensor = _curves()["quantum_efficiency"]
    if mosaic is None:
        return {None: sensor}
    values = sensor.at(WAVELENGTH_NM)
    return {
        letter: Spectrum(WAVELENGTH_NM, values * dye.at(WAVELENGTH_NM), "zero") for letter, dye in mosaic.dyes.items()
    }


def write_photographs(
    folder: Path,
    signals: NDArray[np.float64],
    field: NDArray[np.float64],
    sees_lamp: NDArray[np.bool_],
    *,
    camera: Camera,
    scene: Scene,
    settings: CaptureSettings,
    seed: int,
    hooks: FrameHooks | None = None,
) -> None:
    """Write the folder of a capture, simulated from expected signals.

    Parameters
    ----------
    folder
        Folder to write; an incomplete one is removed.
    signals
        (band, y, x) signals of the scene, DN/s, in the order of the settings' bands; behind a mosaic at all pixels, as
        if each had the band's channel.
    field
        (band, y, x) signals of the sphere, DN/s.
    sees_lamp
        (y, x) pixels ignored in the choice of exposures.
    camera
        Camera of the survey; it is not written.
    scene
        Scene of the survey and of the lamp's measurement.
    settings
        Settings of the laboratory.
    seed
        Seed of all random numbers.
    hooks
        Changes inside the camera; None for none.

    Raises
    ------
    InputError
        If the folder is not empty, or no exposure fits the radiance.
    """
    filters = tuple(settings.filters)
    signals, field = (_frames_of_filters(planes, settings) for planes in (signals, field))
    streams = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(5)]
    maps = pixel_maps(camera, settings, streams[0])
    rates = {
        name: dict(zip(filters, np.percentile(values[:, ~ignored], 99.5, axis=1).tolist(), strict=True))
        for name, values, ignored in (
            ("scene", signals * maps.flat, sees_lamp),
            ("field", field * maps.flat, np.zeros_like(sees_lamp)),
        )
    }
    shots = plan_shots(rates["scene"], rates["field"], settings, streams[1])

    def light(shot: Shot) -> NDArray[np.float64]:
        source = signals if shot.kind == "band" else field
        return source[filters.index(str(shot.filter))]

    frames = photograph(shots, light, maps, settings, streams[2], hooks)
    points, image_px = survey(scene, camera, settings.point_count, settings.point_sigma_px, streams[3])
    error = settings.lamp_relative_uncertainty * streams[4].standard_normal()
    lamp = scene.lamp.radiance.scaled(1 + error)
    with replacing_folder(folder) as temporary:
        for path, counts in frames.items():
            write_raw(temporary / path, counts)
        _write_spectra(temporary / "spectra", settings, lamp)
        _write_points(temporary / "points.csv", points, image_px)
        text = _manifest(camera, scene.name, settings, shots)
        (temporary / "capture.toml").write_text(text, encoding="utf-8")


def _frames_of_filters(planes: NDArray[np.float64], settings: CaptureSettings) -> NDArray[np.float64]:
    """(filter, y, x) signals on the sensor, from those of the bands (band, y, x)."""
    frames = []
    for name in settings.filters:
        behind = [index for index, band in enumerate(settings.bands) if band.filter == name]
        frames.append(interleaved(planes[behind], [settings.bands[index] for index in behind], settings.mosaic))
    return np.stack(frames)


def _write_spectra(folder: Path, settings: CaptureSettings, lamp: Spectrum) -> None:
    folder.mkdir()
    common, filters = dict(_curves()), settings.filters
    if settings.mosaic is not None:
        common = {"lens": common["lens"], **{str(c): q for c, q in channel_efficiencies(settings.mosaic).items()}}
    wide = next(iter(filters.values())).wavelength_nm
    tables: tuple[tuple[str, NDArray[np.float64], Mapping[str, Spectrum]], ...] = (
        ("camera", WAVELENGTH_NM, common),
        ("filters", wide, filters),
        ("lamp", WAVELENGTH_NM, {"radiance": lamp}),
        ("sphere", WAVELENGTH_NM, {"radiance": sphere_spectrum(settings.sphere_brightness)}),
    )
    for name, grid, columns in tables:
        rows = np.column_stack([grid, *(curve.at(grid) for curve in columns.values())])
        header = ",".join(["wavelength_nm", *columns])
        np.savetxt(folder / f"{name}.csv", rows, "%.8g", ",", header=header, comments="")


def _write_points(path: Path, points: NDArray[np.float64], image_px: NDArray[np.float64]) -> None:
    rows = [
        f"p{index:02d},{x:.2f},{y:.2f},{z:.2f},{u:.3f},{v:.3f}"
        for index, ((x, y, z), (u, v)) in enumerate(zip(points, image_px, strict=True), 1)
    ]
    path.write_text("\n".join(["id,x_mm,y_mm,z_mm,u_px,v_px", *rows]) + "\n", encoding="utf-8")


def toml_table(header: str, **entries: object) -> str:
    """Text of a TOML table.

    Tables are written one by one, since a table that occurs several times, [[dark]], may be added to a manifest later.

    Parameters
    ----------
    header
        ``[camera]``, ``[[band]]``, or the empty text for entries in front of all tables.
    **entries
        Strings, numbers and lists of strings; entries of None are left out.

    Returns
    -------
    str
        The header and a line, or several, for each entry.
    """
    # text of NumPy's numbers depends on its print options, which other libraries change
    plain = {key: value.item() if isinstance(value, np.generic) else value for key, value in entries.items()}
    text = tomli_w.dumps({key: value for key, value in plain.items() if value is not None})
    return f"{header}\n{text}" if header else text


def _manifest(camera: Camera, scene: str, settings: CaptureSettings, shots: Sequence[Shot]) -> str:
    parts = [
        toml_table(
            "", format="capture/1", name=settings.name or scene.replace("-", " "), scene=settings.scene or scene
        ),
        toml_table(
            "[camera]",
            model=settings.model,
            width_px=camera.width_px,
            height_px=camera.height_px,
            pixel_pitch_um=settings.film_width_mm * 1e3 / camera.width_px,
            bit_depth=settings.bit_depth,
            gain_e_per_dn=settings.gain_e_per_dn,
            read_noise_e=settings.read_noise_e,
            readout_s=settings.readout_s,
            quantum_efficiency=None if settings.mosaic else "spectra/camera.csv:quantum_efficiency",
        ),
        *_mosaic_tables(settings.mosaic),
        toml_table("[lens]", focal_length_mm=settings.focal_length_mm, transmittance="spectra/camera.csv:lens"),
    ]
    for shot in shots:
        entries: dict[str, object] = {"frames": shot.paths, "exposure_s": shot.exposure_s}
        if shot.kind != "dark":
            entries |= {"f_number": settings.f_number, "image_distance_mm": settings.image_distance_mm}
        if shot.kind == "reference":
            entries = {"radiance": "spectra/sphere.csv:radiance", **entries}
        if shot.kind == "dark":
            parts.append(toml_table("[[dark]]", **entries))
        for band in settings.bands:
            if shot.kind == "band" and band.filter == shot.filter:
                column = f"spectra/filters.csv:{band.filter}"
                keys: dict[str, object] = {"id": band.id, "channel": band.channel, "transmittance": column}
                parts.append(toml_table("[[band]]", **keys, **entries, start_s=shot.start_s))
            elif band.filter == shot.filter:
                parts.append(toml_table(f"[[{shot.kind}]]", band=band.id, **entries))
    relative = settings.lamp_relative_uncertainty
    parts.append(toml_table("[lamp]", radiance="spectra/lamp.csv:radiance", relative_uncertainty=relative))
    parts.append(toml_table("[geometry]", points="points.csv", point_sigma_px=settings.point_sigma_px))
    return "\n".join(parts)


def _mosaic_tables(mosaic: MosaicSensor | None) -> list[str]:
    """Tables of the mosaic and of its channels' quantum efficiencies; none without one."""
    if mosaic is None:
        return []
    columns = {letter: f"spectra/camera.csv:{letter}" for letter in mosaic.dyes}
    return [toml_table("[camera.quantum_efficiency]", **columns), toml_table("[mosaic]", pattern=mosaic.pattern)]
