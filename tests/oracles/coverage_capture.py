"""Small captures of known truth for the coverage of calibration: a chart under uneven light, photographed whole.

As many frames as a laboratory takes (bands, darks, flats, references, brackets, a reference series at several times
and f-numbers), on a cut-down sensor whose pixels are as large and as bright as those of the full one. What is not
noise is drawn as well: the reference source's scale, each filter's transmittance, what lamp and shutter do from frame
to frame, and the survey.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cboxlab.calibration.colour.radiance_ensemble import measured_reflectances
from cboxlab.calibration.detector.response import REPEATABILITY
from cboxlab.rendering.files.raw_files import write_raw
from cboxlab.rendering.synthetic.capture_writer import (
    sphere_spectrum,
    toml_table,
    tungsten_lamp,
    unit_factors,
    write_photographs,
)
from cboxlab.rendering.synthetic.photographer import (
    CaptureSettings,
    Frame,
    FrameHooks,
    PixelMaps,
    Shot,
    photograph,
    pixel_maps,
)
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.cornell_box import cornell_box
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.validation.synthetic.model_capture import perturbed_camera
from numpy.typing import NDArray
from PIL import Image

__all__ = ["REFERENCE_SIGMA", "SERIES_BAND", "SIZE", "Truth", "make_capture"]

#: The frames' width and height, and of the full sensor whose middle they are as bright as.
SIZE, _FULL = 48, 256
#: Relative standard deviations of the reference source's scale, and of a filter's transmittance.
REFERENCE_SIGMA, FILTER_SIGMA = 0.003, 0.004
#: The band with brackets and a reference series.
SERIES_BAND = "f550"

_SERIES_F_NUMBERS = (5.6, 11.0, 16.0)
# Of the lamp's radiance, what a white surface in the box sends to the camera.
_LIGHT = 0.05
_WHITE, _BLACK = 0.9, 0.03


@dataclass(frozen=True, eq=False)
class Truth:
    """What a capture was made of.

    radiance : (y, x, wavelength). rate, field : (band, y, x) DN/s for a flat of 1 as the stated filters would pass
    them, sphere as stated. filters : (band,) true over stated transmittance. reference : true over stated radiance
    of the sphere. opened_s : by frame path, how long the shutter was open. reflectance : (patch, wavelength).
    light : (y, x) relative illumination.
    """

    camera: Camera
    settings: CaptureSettings
    maps: PixelMaps
    radiance: NDArray[np.float64]
    rate: NDArray[np.float64]
    field: NDArray[np.float64]
    filters: NDArray[np.float64]
    reference: float
    opened_s: dict[str, float]
    reflectance: NDArray[np.float64]
    light: NDArray[np.float64]


def _illumination(rng: np.random.Generator) -> NDArray[np.float64]:
    v, u = np.indices((SIZE, SIZE)) / (SIZE - 1) * 2 - 1
    terms = np.stack([u, v, u * u, u * v, v * v])
    return np.asarray(np.exp(np.tensordot(0.15 * rng.standard_normal(5), terms, 1)), np.float64)


def _patches(rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """(9, wavelength) reflectances, the first white and the last black, and the (y, x) label image."""
    curves = rng.choice([c for c in measured_reflectances().values() if c.mean() > 2 * _BLACK], 7, replace=False)
    ends = [np.full((1, WAVELENGTH_NM.size), value) for value in (_WHITE, _BLACK)]
    v, u = np.indices((SIZE, SIZE)) // (SIZE // 3)
    return np.vstack([ends[0], curves, ends[1]]), (3 * v + u + 1).astype(np.uint8)


def _series(manifest_shots: list[tuple[Shot, float, float]]) -> str:
    text = ""
    for shot, f_number, distance in manifest_shots:
        entries: dict[str, object] = {
            "band": SERIES_BAND,
            "frames": shot.paths,
            "exposure_s": shot.exposure_s,
        }
        kind = "bracket"
        if shot.kind == "reference":
            kind, entries = "reference", {"radiance": "spectra/sphere.csv:radiance", **entries}
        text += "\n" + toml_table(f"[[{kind}]]", **entries, f_number=f_number, image_distance_mm=distance)
    return text


def make_capture(folder: Path, seed: int) -> Truth:
    """Write the capture of a seed to a folder that does not exist yet, and return its true values."""
    rng = np.random.default_rng([seed, 5])
    part = SIZE / _FULL
    settings = CaptureSettings(
        film_width_mm=25.0 * part,
        focal_length_mm=35.0 * part,
        image_distance_mm=36.6 * part,
        reference_repeats=2,
        point_count=30,
        point_sigma_px=0.15 * part,
        hot_share=2e-3,
    )
    camera, responses = perturbed_camera(SIZE, seed), unit_factors(settings, SIZE).responses()
    first = np.random.default_rng(np.random.SeedSequence(seed).spawn(5)[0])
    maps = pixel_maps(camera, settings, first)
    reflectance, labels = _patches(rng)
    light, lamp = _illumination(rng), tungsten_lamp()
    radiance = _LIGHT * lamp.values * light[..., None] * reflectance[labels - 1]
    rate = np.stack([response.signal(radiance) for response in responses])
    sphere = np.array([response.signal(sphere_spectrum().values) for response in responses])
    field = np.tile(sphere[:, None, None], (1, SIZE, SIZE))
    filters = 1 + FILTER_SIGMA * rng.standard_normal(len(responses))
    reference = 1 + REFERENCE_SIGMA * rng.standard_normal()
    opened: dict[str, float] = {}

    def exposure(frame: Frame) -> float:
        # A dark has no shutter and no lamp.
        off = 0.0 if frame.kind == "dark" else REPEATABILITY * rng.standard_normal()
        seconds = frame.exposure_s * (1 + off)
        opened[f"{frame.kind} {frame.filter} {frame.exposure_s:g} {frame.repeat}"] = seconds
        return seconds

    hooks = FrameHooks(exposure_s=exposure)
    write_photographs(
        folder,
        rate * filters[:, None, None],
        field * filters[:, None, None] * reference,
        np.zeros((SIZE, SIZE), bool),
        camera=camera,
        scene=cornell_box().with_lamp(lamp),
        settings=settings,
        seed=seed,
        hooks=hooks,
    )
    truth = Truth(camera, settings, maps, radiance, rate, field, filters, reference, opened, reflectance, light)
    _add_series(folder, truth, [r.band for r in responses].index(SERIES_BAND), hooks, rng)
    _add_labels(folder, truth, labels)
    return truth


def _add_series(folder: Path, truth: Truth, band: int, hooks: FrameHooks, rng: np.random.Generator) -> None:
    """Brackets of the scene and references at other times and f-numbers, at exposures that have darks."""
    manifest = folder / "capture.toml"
    text = manifest.read_text(encoding="utf-8")
    times = sorted({float(p.name[5:-7]) for p in (folder / "frames").glob("dark-*s-0.tif")})
    settings, scale = truth.settings, truth.filters[band]
    shots: list[tuple[Shot, float, float]] = []
    for kind, signal in (
        ("bracket", truth.rate[band] * scale),
        ("reference", truth.field[band] * scale * truth.reference),
    ):
        longest = 0.65 * settings.full_scale_dn / float((signal * truth.maps.flat).max())
        usable = [t for t in times if 0.03 * longest < t < longest]
        plan = [(t, settings.f_number) for t in usable]
        if kind == "reference":
            plan += [(usable[-2], f_number) for f_number in _SERIES_F_NUMBERS]
        for number, (seconds, f_number) in enumerate(plan):
            shot = Shot("reference" if kind == "reference" else "band", f"{kind}{number}", seconds, 2)
            light = signal * (settings.f_number / f_number) ** 2
            frames = photograph((shot,), lambda _, s=light: s, truth.maps, settings, rng, hooks)
            for path, counts in frames.items():
                write_raw(folder / path, counts)
            shots.append((shot, f_number, settings.image_distance_mm))
    manifest.write_text(text + _series(shots), encoding="utf-8")


def _add_labels(folder: Path, truth: Truth, labels: NDArray[np.uint8]) -> None:
    Image.fromarray(labels).save(folder / "labels.png")
    rows = "".join(f"{i},{'white' if i == 1 else f'p{i}'},{'white' if i == 1 else ''}\n" for i in range(1, 10))
    (folder / "names.csv").write_text("label,name,column\n" + rows)
    (folder / "known.csv").write_text(f"wavelength_nm,white\n380,{_WHITE}\n730,{_WHITE}\n")
    entries = {"image": "labels.png", "names": "names.csv", "reflectance": "known.csv"}
    with open(folder / "capture.toml", "a", encoding="utf-8") as stream:
        stream.write("\n" + toml_table("[labels]", **entries))
