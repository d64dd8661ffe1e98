"""A complete capture of a rendered box: a folder like a laboratory's (capture format, version 1)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from cboxlab.calibration.sensor_equation import (
    PLANCK_J_S,
    SPEED_OF_LIGHT_M_S,
    WAVELENGTH_NM,
    BandResponse,
)
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.files import replacing_folder
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.spectra import Spectrum, planck, read_spectra
from numpy.typing import NDArray

from .bands import render_bands
from .image import RenderedImage
from .laboratory import CaptureSettings, FrameHooks, Shot, photograph, pixel_maps, plan_shots
from .raw_files import write_raw
from .sensor_cameras import PACKAGED
from .survey import survey

__all__ = [
    "band_filters", "expected_signals", "field_signals", "sphere_spectrum", "toml_table", "tungsten_lamp",
    "unit_responses", "write_capture", "write_photographs",
]  # fmt: skip


def tungsten_lamp(radiance_550: float = 8e-4, temperature_k: float = 3000.0) -> Spectrum:
    """A lamp for captures: Planck's law through a neutral diffuser, W m^-2 sr^-1 nm^-1, 400 to 700 nm."""
    return Spectrum(WAVELENGTH_NM, radiance_550 * planck(WAVELENGTH_NM, temperature_k), "zero")


def sphere_spectrum() -> Spectrum:
    """The integrating sphere: illuminant A's temperature, 2856 K, about as bright as a wall of the box."""
    return Spectrum(WAVELENGTH_NM, 1e-5 * planck(WAVELENGTH_NM, 2856.0), "zero")


@lru_cache
def _curves() -> dict[str, Spectrum]:
    return read_spectra(PACKAGED / "pxl1300l.csv", "zero")


@lru_cache
def band_filters() -> dict[str, Spectrum]:
    """Transmittances of the seven filters by band, 380 to 720 nm."""
    return read_spectra(PACKAGED / "pxl1300l-filters.csv", "zero")


def unit_responses(
    settings: CaptureSettings, width_px: int, filters: Mapping[str, Spectrum] | None = None
) -> tuple[BandResponse, ...]:
    """The bands' responses for one second: K = C / (f_number^2 d^2), so that signals come in DN/s.

    filters : other transmittances than band_filters, by band.
    """
    quanta = WAVELENGTH_NM * 1e-9 / (PLANCK_J_S * SPEED_OF_LIGHT_M_S)
    common = quanta * np.prod([curve.at(WAVELENGTH_NM) for curve in _curves().values()], axis=0)
    pixel_area = (settings.film_width_mm * 1e-3 / width_px) ** 2
    constant = np.pi / 4 * settings.focal_length_mm**2 * pixel_area / settings.gain_e_per_dn
    factor = constant / (settings.f_number * settings.image_distance_mm) ** 2
    return tuple(
        BandResponse(band, WAVELENGTH_NM, common * curve.at(WAVELENGTH_NM), factor)
        for band, curve in (filters or band_filters()).items()
    )


def expected_signals(image: RenderedImage, responses: tuple[BandResponse, ...]) -> NDArray[np.float64]:
    """(band, y, x) DN/s above dark for a flat of 1, without noise; the image is on WAVELENGTH_NM."""
    return render_bands(image, responses)["signal"].values


def field_signals(responses: tuple[BandResponse, ...], shape: tuple[int, int]) -> NDArray[np.float64]:
    """(band, y, x) DN/s of the integrating sphere that fills the field."""
    levels = np.array([response.signal(sphere_spectrum().values) for response in responses])
    return np.broadcast_to(levels[:, None, None], (len(responses), *shape))


def write_capture(
    folder: Path, image: RenderedImage, camera: Camera, scene: Scene, settings: CaptureSettings, seed: int
) -> None:
    """Write the capture that the settings' laboratory takes of a rendered scene; all or nothing.

    image : on WAVELENGTH_NM, of ``scene`` with a lamp of absolute radiance (see tungsten_lamp), through
    ``camera``, the true one, which the capture itself does not tell. Repeatable by ``seed``.

    Raises InputError where the folder holds anything, or where no exposure suits the radiance.
    """
    responses = unit_responses(settings, camera.width_px)
    shape = camera.height_px, camera.width_px
    signals, field = expected_signals(image, responses), field_signals(responses, shape)
    write_photographs(folder, signals, field, image.sees_lamp, camera, scene, settings, seed)


def write_photographs(
    folder: Path,
    signals: NDArray[np.float64],
    field: NDArray[np.float64],
    sees_lamp: NDArray[np.bool_],
    camera: Camera,
    scene: Scene,
    settings: CaptureSettings,
    seed: int,
    hooks: FrameHooks | None = None,
) -> None:
    """Photograph expected signals and write the folder: ``write_capture`` after the optics.

    signals, field : (band, y, x) DN/s of the scene and of the sphere, in the order of band_filters.
    sees_lamp : (y, x) left out where exposures are chosen. camera, scene : as they were when the points were
    surveyed and the lamp was measured. hooks : what goes wrong inside the camera.
    """
    bands = tuple(band_filters())
    streams = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(5)]
    maps = pixel_maps(camera, settings, streams[0])
    rates = {
        name: dict(zip(bands, np.percentile(values[:, ~lit], 99.5, axis=1).tolist(), strict=True))
        for name, values, lit in (
            ("scene", signals * maps.flat, sees_lamp),
            ("field", field * maps.flat, np.zeros_like(sees_lamp)),
        )
    }
    shots = plan_shots(rates["scene"], rates["field"], settings, streams[1])

    def light(shot: Shot) -> NDArray[np.float64]:
        source = signals if shot.kind == "band" else field
        return source[bands.index(str(shot.band))]

    frames = photograph(shots, light, maps, settings, streams[2], hooks)
    points, image_px = survey(scene, camera, settings.point_count, settings.point_sigma_px, streams[3])
    error = settings.lamp_relative_uncertainty * streams[4].standard_normal()
    lamp = scene.lamp.radiance.scaled(1 + error)
    with replacing_folder(folder) as temporary:
        for path, counts in frames.items():
            write_raw(temporary / path, counts)
        _write_spectra(temporary / "spectra", lamp)
        _write_points(temporary / "points.csv", points, image_px)
        text = _manifest(camera, scene.name, settings, shots)
        (temporary / "capture.toml").write_text(text, encoding="utf-8")


def _write_spectra(folder: Path, lamp: Spectrum) -> None:
    folder.mkdir()
    common, filters = _curves(), band_filters()
    wide = next(iter(filters.values())).wavelength_nm
    tables: tuple[tuple[str, NDArray[np.float64], Mapping[str, Spectrum]], ...] = (
        ("camera", WAVELENGTH_NM, common), ("filters", wide, filters),
        ("lamp", WAVELENGTH_NM, {"radiance": lamp}),
        ("sphere", WAVELENGTH_NM, {"radiance": sphere_spectrum()}),
    )  # fmt: skip
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
    """A table of a TOML file: strings, numbers and lists of strings."""
    # JSON's are TOML's
    lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in entries.items()]
    return "\n".join([header, *lines]).strip() + "\n"


def _manifest(camera: Camera, scene: str, settings: CaptureSettings, shots: Sequence[Shot]) -> str:
    parts = [
        toml_table("", format="capture/1", name=settings.name, scene=scene),
        toml_table(
            "[camera]", model=settings.model, width_px=camera.width_px, height_px=camera.height_px,
            pixel_pitch_um=settings.film_width_mm * 1e3 / camera.width_px, bit_depth=settings.bit_depth,
            gain_e_per_dn=settings.gain_e_per_dn, read_noise_e=settings.read_noise_e,
            readout_s=settings.readout_s, quantum_efficiency="spectra/camera.csv:quantum_efficiency",
        ),
        toml_table(
            "[lens]", focal_length_mm=settings.focal_length_mm, transmittance="spectra/camera.csv:lens"
        ),
    ]  # fmt: skip
    for shot in shots:
        own: dict[str, object] = {"frames": shot.paths, "exposure_s": shot.exposure_s}
        if shot.kind != "dark":
            own |= {"f_number": settings.f_number, "image_distance_mm": settings.image_distance_mm}
        if shot.kind == "band":
            filter_column = f"spectra/filters.csv:{shot.band}"
            own = {"id": shot.band, "transmittance": filter_column, **own, "start_s": shot.start_s}
        elif shot.kind != "dark":
            own = {"band": shot.band, **own}
        if shot.kind == "reference":
            own = {"radiance": "spectra/sphere.csv:radiance", **own}
        parts.append(toml_table(f"[[{shot.kind}]]", **own))
    relative = settings.lamp_relative_uncertainty
    parts.append(toml_table("[lamp]", radiance="spectra/lamp.csv:radiance", relative_uncertainty=relative))
    parts.append(toml_table("[geometry]", points="points.csv", point_sigma_px=settings.point_sigma_px))
    return "\n".join(parts)
