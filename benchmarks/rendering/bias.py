"""How far the estimators are from the truth: surface means against each other, and the white furnace."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.image.image import RenderedImage
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.integrators.stock import render_stock
from cboxlab.rendering.radiosity.final_gather import NEAR_PATCHES, gather, render_final_gather, solve_light
from cboxlab.rendering.visibility.primary import facet_coverage
from cboxlab.rendering.visibility.tracer import build_tracer
from cboxlab.scenes import Camera, Lamp, Material, Scene, Spectrum, Surface, cornell_box, cornell_camera
from cboxlab.scenes.shapes import quad_mesh, ring_mesh
from contenders import BANDS, REFERENCE_BANDS

__all__ = ["furnace", "refinement_bias", "surface_bias"]

SIZE, BATCHES = 32, 16
FLAT = Spectrum(np.array([300.0, 900.0]), np.ones(2), "zero")
#: Paths of the trial that shows how many a surface takes.
TRIAL = 4e6
Render = Callable[[Camera, int, int], RenderedImage]


def surface_bias(error: float, stock: bool) -> dict[str, dict[str, Any]]:
    """Surface means by path tracer, final gather and stock Mitsuba, each to about a relative standard ``error``.

    Every surface is rendered in a separate picture, the part of one camera's picture that it covers, with as
    many samples as its noise requires. Returns, for "path" (against stock, at three bands) and "default" (against
    the path tracer, at all; each batch with its radiosity solution), the largest relative difference over
    surfaces and bands with its standard error, the rms of all differences freed of noise, how the differences
    over their standard errors are distributed, and the mean over bands for each surface.
    """
    scene, bands = cornell_box().with_lamp(FLAT), BANDS[REFERENCE_BANDS]
    solutions = [solve_light(scene, BANDS, seed=1000 + number) for number in range(BATCHES)]

    def path(view: Camera, samples: int, seed: int) -> RenderedImage:
        return render_path_tracer(RenderJob(scene, view, BANDS, samples, BATCHES, seed=seed))

    def default(view: Camera, samples: int, seed: int) -> RenderedImage:
        images = [gather(light, view, samples, 1, seed + number) for number, light in enumerate(solutions)]
        # one basis holds all: each solution has another
        values = np.concatenate([image.coefficients @ image.spectra for image in images])
        return replace(images[0], coefficients=values, spectra=np.eye(len(BANDS)))

    def mitsuba(view: Camera, samples: int, seed: int) -> RenderedImage:
        return render_stock(RenderJob(scene, view, bands, samples, BATCHES, seed=seed), variant="llvm_ad_rgb")

    ways: dict[str, Render] = {"path": path, "default": default, **({"stock": mitsuba} if stock else {})}
    means: dict[str, list[np.ndarray]] = {name: [] for name in ways}
    names = [surface.name for surface in scene.surfaces]
    for view, pixels in _views(scene):
        for name, render in ways.items():
            means[name].append(_mean(render, view, pixels, error))
    path_means = np.stack(means["path"], axis=1)
    results = {"default": _compared(np.stack(means["default"], axis=1), path_means, names)}
    if stock:
        results["path"] = _compared(path_means[..., REFERENCE_BANDS], np.stack(means["stock"], axis=1), names)
    return results


def _views(scene: Scene) -> list[tuple[Camera, np.ndarray]]:
    """For each surface the part of a camera's picture that shows it, and the pixels (y, x) that see it alone."""
    camera, tracer = cornell_camera(128), build_tracer(scene)
    alone = facet_coverage(tracer, camera, samples=1024)[..., :-1] > 1 - 1e-6
    views = []
    for index in range(len(scene.surfaces)):
        mask = alone[..., tracer.facet_surface[:-1] == index].any(axis=-1)
        y, x = np.nonzero(mask)
        view = replace(
            camera,
            width_px=int(np.ptp(x)) + 1,
            height_px=int(np.ptp(y)) + 1,
            principal_point_px=camera.principal_point_px - [x.min(), y.min()],
        )
        views.append((view, mask[y.min() : y.max() + 1, x.min() : x.max() + 1]))
    return views


def _mean(render: Render, view: Camera, pixels: np.ndarray, error: float) -> np.ndarray:
    """(batch, w) means over ``pixels`` (y, x), to about a relative standard ``error``."""

    def run(samples: int, seed: int) -> np.ndarray:
        image = render(view, samples, seed)
        return (image.coefficients @ image.spectra)[:, pixels].mean(axis=1)

    samples = max(2, int(TRIAL / BATCHES / view.width_px / view.height_px))
    trial = run(samples, 1)
    deviation = trial.std(axis=0, ddof=1) / np.sqrt(BATCHES) / trial.mean(axis=0)
    return run(int(2 * np.ceil(samples / 2 * max((deviation.max() / error) ** 2, 1))), 2)


def refinement_bias(samples: int) -> dict[str, Any]:
    """The final gather's bias, from patches smaller by the square root of 2 and the same random numbers.

    What patches' size does to smooth light goes as its square, so the default's bias is twice the difference.
    Returns its largest value over surfaces and bands with the standard error, and each surface's mean over bands.
    """
    scene, camera, rounds, edge = cornell_box().with_lamp(FLAT), cornell_camera(SIZE), 12, 48.0
    means = []
    for seed in range(rounds):
        pair = []
        for size in (edge, edge / np.sqrt(2)):
            light = replace(solve_light(scene, BANDS, patch_edge_mm=size, seed=seed), near=NEAR_PATCHES * edge)
            image = gather(light, camera, samples, 1, seed=seed)
            pair.append(_means(image))
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


def _means(image: RenderedImage) -> np.ndarray:
    """(surface, w) over the pixels that see one face alone."""
    values = (image.coefficients @ image.spectra)[0]
    names = range(len(image.surface_names))
    return np.stack([values[image.single_surface & (image.surface == i)].mean(axis=0) for i in names])


def _compared(first: np.ndarray, other: np.ndarray, names: list[str]) -> dict[str, Any]:
    """Of (batch, surface, w) means."""
    difference = first.mean(axis=0) / other.mean(axis=0) - 1
    error = np.sqrt(sum(x.var(axis=0, ddof=1) / len(x) / x.mean(axis=0) ** 2 for x in (first, other)))
    worst = np.unravel_index(np.argmax(np.abs(difference)), difference.shape)
    return {
        "max_bias": float(np.abs(difference[worst])),
        "max_bias_standard_error": float(error[worst]),
        "median_standard_error": float(np.median(error)),
        "rms_bias_beyond_noise": float(np.sqrt(max(np.mean(difference**2 - error**2), 0.0))),
        "largest_standard_error": float(error.max()),
        "of_surfaces": dict(zip(names, difference.mean(axis=1).tolist(), strict=True)),
        "rms_over_standard_error": float(np.sqrt(np.mean((difference / error) ** 2))),
        "max_over_standard_error": float(np.max(np.abs(difference / error))),
        "comparisons": int(difference.size),
    }


def furnace(samples: int) -> dict[str, dict[str, float]]:
    """White furnace: a closed cube of reflectance 1 under a black lamp of radiance 1 has radiance 1 everywhere.

    Returns the mean's distance from 1 and its standard error, by path tracer and final gather (each batch with its
    radiosity solution).
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
    hole = ceiling.mean(axis=0) + 0.95 * (ceiling - ceiling.mean(axis=0))
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
            image = integrator(RenderJob(scene, camera, BANDS[15:16], samples, 1, seed=batch))
            walls = image.single_surface & (image.surface >= 0)
            means.append((image.coefficients @ image.spectra)[0, walls].mean())
        results[name] = {
            "distance_from_1": float(np.mean(means) - 1),
            "standard_error": float(np.std(means, ddof=1) / np.sqrt(BATCHES)),
        }
    return results
