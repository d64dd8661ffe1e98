"""How far the estimators are from the truth: surface means against each other, and the white furnace."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.render.final_gather import gather, render_final_gather, solve_light
from cboxlab.render.image import RenderedImage
from cboxlab.render.path_tracer import render_path_tracer
from cboxlab.render.stock import render_stock
from cboxlab.scenes import Camera, Lamp, Material, Scene, Spectrum, Surface, cornell_box, cornell_camera
from cboxlab.scenes.shapes import quad_mesh, ring_mesh
from contenders import BANDS, REFERENCE_BANDS

__all__ = ["furnace", "refinement_bias", "surface_bias"]

SIZE, BATCHES = 32, 16
FLAT = Spectrum(np.array([300.0, 900.0]), np.ones(2), "zero")


def surface_bias(samples: int, stock: bool) -> dict[str, dict[str, float]]:
    """Surface means by path tracer (``samples`` per pixel and batch), final gather (as many) and stock Mitsuba.

    Returns, for "path" (against stock, at three bands) and "default" (against the path tracer, at all), the largest
    relative difference over surfaces and bands with its standard error, the rms of all differences freed of noise,
    and how the differences over their standard errors are distributed.
    """
    scene, camera = cornell_box().with_lamp(FLAT), cornell_camera(SIZE)
    path = render_path_tracer(scene, camera, BANDS, samples, BATCHES, seed=1)
    solutions = [render_final_gather(scene, camera, BANDS, samples, 1, seed=1000 + n) for n in range(BATCHES)]
    gathered = [_means(image, path) for image in solutions]  # each with a radiosity solution of its own
    results = {"default": _compared(np.concatenate(gathered), _means(path, path))}
    if stock:
        reference = render_stock(
            scene, camera, BANDS[REFERENCE_BANDS], samples, BATCHES, seed=3, variant="llvm_ad_rgb"
        )
        results["path"] = _compared(_means(path, path)[..., REFERENCE_BANDS], _means(reference, path))
    return results


def refinement_bias(samples: int) -> dict[str, Any]:
    """The final gather's bias, from patches smaller by the square root of 2 and the same random numbers.

    What patches' size does to smooth light goes as its square, so the default's bias is twice the difference.
    Returns its largest value over surfaces and bands with the standard error, and each surface's mean over bands.
    """
    scene, camera, rounds, edge = cornell_box().with_lamp(FLAT), cornell_camera(SIZE), 4, 40.0
    means = []
    for seed in range(rounds):
        pair = []
        for size in (edge, edge / np.sqrt(2)):
            light = replace(solve_light(scene, BANDS, patch_edge_mm=size, seed=seed), near=2 * edge)
            image = gather(light, camera, samples, 1, seed=seed)
            pair.append(_means(image, image)[0])
        means.append(pair)
    values = np.array(means)
    bias = 2 * (values[:, 0] - values[:, 1]) / values[:, 0].mean(axis=0)
    error = bias.std(axis=0, ddof=1) / np.sqrt(rounds)
    mean = bias.mean(axis=0)
    worst = np.unravel_index(np.argmax(np.abs(mean)), mean.shape)
    surfaces = zip((s.name for s in scene.surfaces), mean.mean(axis=1), strict=True)
    return {
        "max_bias": float(np.abs(mean[worst])),
        "max_bias_standard_error": float(error[worst]),
        "of_surfaces": {name: float(value) for name, value in surfaces},
    }


def _means(image: RenderedImage, like: RenderedImage) -> np.ndarray:
    """(batch, surface, w) over the pixels that see one face alone."""
    values = image.coefficients @ image.spectra
    names = range(len(like.surface_names))
    return np.stack([values[:, like.pure & (like.surface == i)].mean(axis=1) for i in names], axis=1)


def _compared(one: np.ndarray, other: np.ndarray) -> dict[str, float]:
    difference = one.mean(axis=0) / other.mean(axis=0) - 1
    error = np.sqrt(sum(x.var(axis=0, ddof=1) / len(x) / x.mean(axis=0) ** 2 for x in (one, other)))
    worst = np.unravel_index(np.argmax(np.abs(difference)), difference.shape)
    whole = one.mean(axis=(0, 1)).mean() / other.mean(axis=(0, 1)).mean() - 1
    return {
        "max_bias": float(np.abs(difference[worst])),
        "max_bias_standard_error": float(error[worst]),
        "median_standard_error": float(np.median(error)),
        "rms_bias_beyond_noise": float(np.sqrt(max(np.mean(difference**2 - error**2), 0.0))),
        "mean_of_all_surfaces": float(whole),
        "rms_over_standard_error": float(np.sqrt(np.mean((difference / error) ** 2))),
        "max_over_standard_error": float(np.max(np.abs(difference / error))),
        "comparisons": int(difference.size),
    }


def furnace(samples: int) -> dict[str, dict[str, float]]:
    """White furnace: a closed cube of reflectance 1 under a black lamp of radiance 1 has radiance 1 everywhere.

    Returns the mean's distance from 1 and its standard error, by path tracer and final gather (each batch with a
    radiosity solution of its own).
    """
    edge = 1000.0
    low_high = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * edge
    corner = np.array([[x, y, z] for z in (0.0, edge) for x, y in low_high])
    inwards = {
        "floor": (0, 4, 5, 1),
        "left": (0, 3, 7, 4),
        "right": (1, 5, 6, 2),
        "front": (0, 1, 2, 3),
        "back": (4, 7, 6, 5),
    }
    surfaces = [Surface(n, "white", *quad_mesh(corner[list(i)])) for n, i in inwards.items()]
    ceiling = corner[[3, 2, 6, 7]]
    hole = ceiling.mean(axis=0) + 0.8 * (ceiling - ceiling.mean(axis=0))
    surfaces.append(Surface("ceiling", "white", *ring_mesh(ceiling, hole)))
    lamp = Lamp(Surface("light", "light", *quad_mesh(hole)), FLAT)
    white = {"white": Material("white", Spectrum(np.array([550.0]), np.ones(1)))}
    scene = Scene("furnace", tuple(surfaces), white, lamp)
    rotation = cornell_camera(24).rotation
    camera = Camera(24, 24, 12.0, np.full(2, 11.5), 0.0, rotation, np.array([500.0, 500.0, 50.0]))
    results = {}
    integrators: dict[str, Callable[..., Any]] = {"path": render_path_tracer, "default": render_final_gather}
    for name, integrator in integrators.items():
        means = []
        for batch in range(BATCHES):
            image = integrator(scene, camera, BANDS[15:16], samples, 1, seed=batch)
            walls = image.pure & (image.surface >= 0)
            means.append((image.coefficients @ image.spectra)[0, walls].mean())
        results[name] = {
            "distance_from_1": float(np.mean(means) - 1),
            "standard_error": float(np.std(means, ddof=1) / np.sqrt(BATCHES)),
        }
    return results
