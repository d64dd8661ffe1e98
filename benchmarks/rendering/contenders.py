"""The renderers that the benchmark compares, each as a function from a seed to one picture (y, x, band)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from cboxlab.scenes import Camera, Scene, Spectrum

__all__ = ["BANDS", "GATHER_FACTOR", "MANY_BANDS", "MONO_BANDS", "REFERENCE_BANDS", "contender", "specfilm"]

BANDS = np.linspace(400.0, 700.0, 31)
MANY_BANDS = np.linspace(400.0, 700.0, 76)
#: Bands of the long stock reference, and bands that stand for all 31 where each costs a separate render.
REFERENCE_BANDS = np.array([5, 15, 25])
MONO_BANDS = np.arange(0, 31, 6)
#: Samples of the path tracer over those of stock Mitsuba.
PATH_FACTOR = 1
#: Samples of the final gather over those of stock Mitsuba. The error of independent samples falls as the root of their
#: number, so their efficiency is the same for any number. The error of scrambled Sobol' points falls faster, so ours
#: are measured where they are used: the default at 4096 samples, where it leaves about 0.15%.
GATHER_FACTOR = 64

Render = Callable[[int], np.ndarray]


def contender(name: str, scene: Scene, camera: Camera, samples: int) -> Render:
    """``name``: path, path-76, default, default-76, specfilm or mono.

    Radiance is relative to the lamp's. Sets Mitsuba's variant, so one contender per process.
    """
    from cboxlab.rendering.image import RenderJob
    from cboxlab.rendering.integrators.path_tracer import render_path_tracer
    from cboxlab.rendering.radiosity.final_gather import render_final_gather

    white = scene.with_lamp(Spectrum(np.array([300.0, 900.0]), np.ones(2), "zero"))
    if name == "specfilm":
        return specfilm(white, camera, samples, BANDS)
    if name == "mono":
        return _mono(white, camera, samples)
    wavelengths = MANY_BANDS if name.endswith("-76") else BANDS
    function, factor = (
        (render_path_tracer, PATH_FACTOR) if name.startswith("path") else (render_final_gather, GATHER_FACTOR)
    )

    def run(seed: int) -> np.ndarray:
        image = function(RenderJob(white, camera, wavelengths, samples=samples * factor, batches=1, seed=seed))
        return image.coefficients[0] @ image.spectra.astype(np.float32)

    return run


def specfilm(scene: Scene, camera: Camera, samples: int, bands_nm: np.ndarray) -> Render:
    """Stock spectral renderings under a lamp of radiance 1.

    Each band as wide as their distance, with (nearly) upright edges: together they use every sampled wavelength once.
    """
    from cboxlab.rendering.device import mi
    from cboxlab.rendering.integrators.stock import scene_dict

    mi.set_variant("llvm_ad_spectral")
    grid = np.linspace(360.0, 830.0, 471)
    paints = {name: _irregular(grid, m.reflectance.at(grid)) for name, m in scene.materials.items()}
    lamp = [_irregular(grid, scene.lamp.reflectance.at(grid))], [{"type": "uniform", "value": 1.0}]
    loaded = mi.load_dict(scene_dict(scene, paints, *lamp), optimize=False)
    step = float(bands_nm[1] - bands_nm[0])
    edges = np.array([-step / 2, 0.01 - step / 2, step / 2 - 0.01, step / 2])
    bands = {f"band_{i:02d}": _irregular(b + edges, [0, 1, 1, 0]) for i, b in enumerate(bands_nm)}
    run = _stock(loaded, camera, {"type": "specfilm", **bands}, samples)
    return lambda seed: run(seed) / (step - 0.01)


def _mono(scene: Scene, camera: Camera, samples: int) -> Render:
    from cboxlab.rendering.device import mi
    from cboxlab.rendering.integrators.stock import scene_dict

    mi.set_variant("llvm_ad_mono")
    runs = []
    for band in BANDS[MONO_BANDS]:
        *levels, mean_value = ({"type": "uniform", "value": float(x)} for x in scene.reflectances(band))
        paints = dict(zip(scene.materials, levels, strict=True))
        loaded = mi.load_dict(
            scene_dict(scene, paints, [mean_value], [{"type": "uniform", "value": 1.0}]), optimize=False
        )
        runs.append(_stock(loaded, camera, {"pixel_format": "luminance"}, samples))
    return lambda seed: np.concatenate([run(seed) for run in runs], axis=-1)


def _stock(loaded: Any, camera: Camera, film: dict[str, Any], samples: int) -> Render:
    from cboxlab.rendering.device import mi
    from cboxlab.rendering.integrators.stock import sensor_dict
    from cboxlab.rendering.visibility.pinhole import film_for

    sensor = mi.load_dict(sensor_dict(film_for(camera, 1), camera, film))
    integrator = mi.load_dict({"type": "path", "max_depth": -1})

    def run(seed: int) -> np.ndarray:
        image = mi.render(loaded, sensor=sensor, integrator=integrator, spp=samples, seed=seed)
        return np.array(image).reshape(camera.height_px, camera.width_px, -1)

    return run


def _irregular(wavelengths: Any, values: Any) -> dict[str, Any]:
    if not np.any(values):
        return {"type": "uniform", "value": 0.0}  # Mitsuba refuses a table of zeros
    return {
        "type": "irregular",
        "wavelengths": ",".join(f"{w:.8g}" for w in wavelengths),
        "values": ",".join(f"{v:.8g}" for v in values),
    }
