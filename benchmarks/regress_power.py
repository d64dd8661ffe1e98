"""False alarms and power of `cbox regress`, beside the per-pixel z-test of a renderer's own tests.

    python benchmarks/regress_power.py alarms [--pairs 1000]
    python benchmarks/regress_power.py power [--seeds 20] [--size 128]

`alarms`: pairs of equal pictures, the published box at 64 x 64 with noise made up in four batches (skewed;
with tails; with a Cauchy distributed firefly in 0.1 % of the pixels; without standard errors). The stated
rate is 0.1 %.
`power`: renders by path tracing with 120 samples per pixel in four batches, each against one baseline of other seed.
The per-pixel rule: z-test of each pixel's mean radiance at alpha 0.01 after Sidak's correction, passed where 99.75 %
of the pixels pass.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from cboxlab.render.integrators import render
from cboxlab.scenes import Camera, Scene, cornell_box, cornell_camera
from cboxlab.validate.model import labelled_cube
from cboxlab.validate.regress import Side, regress_sides, side_of
from scipy.stats import norm

WAVELENGTHS = np.arange(420.0, 701.0, 40.0)
BATCHES, SAMPLES = 4, 30
ALPHA, PART = 0.01, 0.9975

KINDS: dict[str, dict[str, float]] = {
    "skewed": {},
    "with tails": {"tails": 0.02},
    "with fireflies": {"fireflies": 0.001},
    "without standard errors": {"stated": 0.0},
}


def pixel_rule(first: Side, second: Side) -> bool:
    """Whether the per-pixel z-test passes."""
    difference = (second.radiance - first.radiance).mean(axis=-1)
    assert first.variance is not None and second.variance is not None
    # wavelengths of a path tracer are nearly fully correlated
    sigma = np.hypot(*(np.sqrt(side.variance).mean(axis=-1) for side in (first, second)))
    used = sigma > 0
    probability = 2 * norm.sf(np.abs(difference[used]) / sigma[used])
    sidak = 1 - (1 - ALPHA) ** (1 / used.sum())
    return bool((probability > sidak).mean() >= PART)


def made_up(
    clean: Side, rng: np.random.Generator, tails: float = 0, fireflies: float = 0, stated: float = 1
) -> Side:
    """One side with noise of 8 % a pixel, nearly the same at all wavelengths."""
    radiance = clean.radiance
    shape = (BATCHES, *radiance.shape[:2])
    common = (rng.standard_gamma(1.0, shape) - 1) * np.where(rng.random(shape) < tails, 8.0, 1.0)
    own = 0.15 * rng.standard_normal((*shape, radiance.shape[2]))
    values = radiance * (1 + 0.08 * np.sqrt(BATCHES) * (common[..., None] + own))
    hit = rng.random(radiance.shape[:2]) < fireflies
    values = values + np.where(hit, rng.standard_cauchy(hit.shape), 0.0)[..., None] * radiance.mean()
    variance = values.var(axis=0, ddof=1) / BATCHES
    mean = values.mean(axis=0).astype(np.float32).astype(float)
    side = replace(clean, radiance=mean, variance=variance, degrees=BATCHES - 1.0)
    return side if stated else replace(side, variance=None, degrees=0.0)


def alarms(pairs: int) -> None:
    """Print how many equal pairs are told apart."""
    clean = rendered(cornell_box(), cornell_camera(64), 1, samples=256)
    print(f"{pairs} pairs of equal pictures, 64 x 64, noise of 8 % a pixel, four batches")
    for name, options in KINDS.items():
        rng = np.random.default_rng(2026)
        wrong, failed = 0, 0
        for _ in range(pairs):
            first, second = (made_up(clean, rng, **options) for _ in range(2))
            wrong += not regress_sides(first, second)[0].same
            if options.get("stated", 1):
                failed += not pixel_rule(first, second)
        rule = (
            f"per-pixel rule fails {failed}"
            if options.get("stated", 1)
            else "per-pixel rule needs standard errors"
        )
        print(f"{name:25s} false alarms {wrong}; {rule}", flush=True)


def rendered(
    scene: Scene, camera: Camera, seed: int, max_bounces: int | None = None, samples: int = SAMPLES
) -> Side:
    """One path traced picture."""
    image = render(
        scene, camera, WAVELENGTHS, samples, BATCHES, seed=seed, max_bounces=max_bounces, integrator="path"
    )
    return side_of([labelled_cube(image)], [f"seed {seed}"])


def with_paint(scene: Scene, name: str, factor: float) -> Scene:
    """The scene with one paint's reflectance times a factor."""
    paint = scene.materials[name]
    changed = replace(paint, reflectance=paint.reflectance.scaled(factor))
    return replace(scene, materials={**scene.materials, name: changed})


def with_swapped_walls(scene: Scene) -> Scene:
    """Red and green exchanged."""
    other = {"left": "green", "right": "red"}
    surfaces = tuple(replace(s, material=other.get(s.name, s.material)) for s in scene.surfaces)
    return replace(scene, surfaces=surfaces)


def with_tilted_lamp(scene: Scene) -> Scene:
    """The lamp's spectrum 2 % redder from end to end."""
    spectrum = scene.lamp.radiance
    tilt = np.interp(spectrum.wavelength_nm, [400, 700], [0.99, 1.01])
    return scene.with_lamp(replace(spectrum, values=spectrum.values * tilt))


def power(seeds: int, size: int) -> None:
    """Print how often each change is seen."""
    box, camera = cornell_box(), cornell_camera(size)
    half = replace(camera, principal_point_px=camera.principal_point_px + np.array([0.5, 0.0]))
    changes: dict[str, Callable[[int], Side]] = {
        "nothing": lambda seed: rendered(box, camera, seed),
        "depth 8": lambda seed: rendered(box, camera, seed, 8),
        "depth 6": lambda seed: rendered(box, camera, seed, 6),
        "white paint x 1.002": lambda seed: rendered(with_paint(box, "white", 1.002), camera, seed),
        "half a pixel": lambda seed: rendered(box, half, seed),
        "swapped walls": lambda seed: rendered(with_swapped_walls(box), camera, seed),
        "lamp 2 % redder": lambda seed: rendered(with_tilted_lamp(box), camera, seed),
    }
    baseline = rendered(box, camera, 1)
    print(f"{size} x {size}, {SAMPLES * BATCHES} samples per pixel, {seeds} seeds")
    for index, (name, change) in enumerate(changes.items()):
        seen, failed, sigmas = 0, 0, []
        for run in range(seeds):
            candidate = change(1000 * (index + 1) + run)
            outcome = regress_sides(baseline, candidate)[0]
            seen += not outcome.same
            failed += not pixel_rule(baseline, candidate)
            sigmas.append(abs(outcome.whole.statistic))
        print(
            f"{name:22s} seen {seen}/{seeds} (whole picture {np.median(sigmas):.1f} sigma, would have seen "
            f"{outcome.whole.detectable:.2%}); per-pixel rule fails {failed}/{seeds}",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=["alarms", "power"])
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--size", type=int, default=128)
    arguments = parser.parse_args()
    if arguments.part == "alarms":
        alarms(arguments.pairs)
    else:
        power(arguments.seeds, arguments.size)


if __name__ == "__main__":
    main()
