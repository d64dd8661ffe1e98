"""False alarms, power and naming of `cbox regress`, next to the per-pixel z-test of a renderer's own tests and FLIP.

    python benchmarks/rendering/regress_power.py alarms [--pairs 1000]
    python benchmarks/rendering/regress_power.py renderers [--pairs 1000]
    python benchmarks/rendering/regress_power.py power [--seeds 20] [--size 128]
    python benchmarks/rendering/regress_power.py naming [--seeds 20] [--size 128] [--rows "tent filter,depth 3"]

`alarms`: pairs of equal pictures, the published box at 64 x 64 with noise made up in four batches (skewed;
with tails; with a Cauchy distributed firefly in 0.1 % of the pixels; without standard errors). The stated
rate is 0.1 %.
`renderers`: pairs across renderers (our path tracer, Mitsuba, Radiance, Raysect, those installed), each picture the
mean of 4 batches drawn from 100 of its renderer, 48 x 48, 16 samples a batch, the lamp black. Of 100 batches 25
pictures are independent, so that the pairs are not.
`power`: renders by path tracing with 120 samples per pixel in four batches, each against one baseline of other seed.
The per-pixel rule: z-test of each pixel's mean radiance at alpha 0.01 after Sidak's correction, passed where 99.75 %
of the pixels pass. FLIP (Andersson et al. 2021; the package flip-evaluator) has no rule: a picture counts as seen
where its mean is above that of all unchanged ones.
`naming`: of pictures rendered the same way, the change named first, with what the row asks of it.
"""

from __future__ import annotations

import argparse
import hashlib
import pickle
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from cboxlab.rendering.export import ExportSettings, exported_scene, renderer_of, write_export
from cboxlab.rendering.files import xyz_weights
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import render_image
from cboxlab.rendering.model import labelled_cube
from cboxlab.rendering.perturbation import PatchLight
from cboxlab.scenes import Camera, Scene, cornell_box, cornell_camera
from cboxlab.validation.compare_renders.regress import Side, regress_sides, side_of
from cboxlab.validation.compare_renders.regress.naming import named_changes
from cboxlab.validation.compare_renders.regress.variants import Variants, build_variants
from cboxlab.validation.compare_renders.renderers import missing, run_renderer
from numpy.typing import NDArray
from scipy.stats import norm

try:
    from flip_evaluator import evaluate
except ImportError:
    evaluate = None

WAVELENGTHS = np.arange(420.0, 701.0, 40.0)
BATCHES, SAMPLES = 4, 30
ALPHA, PART = 0.01, 0.9975
#: Batches of each renderer, pixels a side, samples of a batch.
POOL, POOL_SIZE, POOL_SAMPLES = 100, 48, 16
TO_SRGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])

KINDS: dict[str, dict[str, float]] = {
    "skewed": {},
    "with tails": {"tails": 0.02},
    "with fireflies": {"fireflies": 0.001},
    "without standard errors": {"with_errors": 0.0},
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


def mean_flip(first: Side, second: Side) -> float:
    """HDR-FLIP of two pictures, its mean; NaN without the package."""
    if evaluate is None:
        return float("nan")
    weights = xyz_weights(WAVELENGTHS) @ TO_SRGB.T
    pictures = [np.maximum(side.radiance @ weights, 0).astype(np.float32) for side in (first, second)]
    return float(evaluate(*pictures, "HDR", inputsRGB=False, applyMagma=False)[1])


def made_up(
    clean: Side, rng: np.random.Generator, tails: float = 0, fireflies: float = 0, with_errors: float = 1
) -> Side:
    """One side with noise of 8 % a pixel, nearly the same at all wavelengths."""
    radiance = clean.radiance
    shape = (BATCHES, *radiance.shape[:2])
    common = (rng.standard_gamma(1.0, shape) - 1) * np.where(rng.random(shape) < tails, 8.0, 1.0)
    batch_noise = 0.15 * rng.standard_normal((*shape, radiance.shape[2]))
    values = radiance * (1 + 0.08 * np.sqrt(BATCHES) * (common[..., None] + batch_noise))
    hit = rng.random(radiance.shape[:2]) < fireflies
    values = values + np.where(hit, rng.standard_cauchy(hit.shape), 0.0)[..., None] * radiance.mean()
    variance = values.var(axis=0, ddof=1) / BATCHES
    mean = values.mean(axis=0).astype(np.float32).astype(float)
    side = replace(clean, radiance=mean, variance=variance, degrees=BATCHES - 1.0)
    return side if with_errors else replace(side, variance=None, degrees=0.0)


def alarms(pairs: int) -> None:
    """Print how many equal pairs are distinguished."""
    clean = rendered(cornell_box(), cornell_camera(64), 1, samples=256)
    print(f"{pairs} pairs of equal pictures, 64 x 64, noise of 8 % a pixel, four batches", flush=True)
    for name, options in KINDS.items():
        rng = np.random.default_rng(2026)
        wrong, failed, with_errors = 0, 0, options.get("with_errors", 1)
        for _ in range(pairs):
            first, second = (made_up(clean, rng, **options) for _ in range(2))
            wrong += not regress_sides(first, second)[0].same
            if with_errors:
                failed += not pixel_rule(first, second)
        rule = f"per-pixel rule fails {failed}" if with_errors else "per-pixel rule needs standard errors"
        print(f"{name:25s} false alarms {wrong}; {rule}", flush=True)


def rendered(scene: Scene, camera: Camera, seed: int, max_bounces: int | None = None, samples: int = SAMPLES) -> Side:
    """One path traced picture."""
    image = render_image(
        RenderJob(scene, camera, WAVELENGTHS, samples, BATCHES, seed=seed, max_bounces=max_bounces), integrator="path"
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


def with_coat(scene: Scene) -> Scene:
    """White paint as rough plastic of index 1.5, which reflects 4 % straight on."""
    bsdf = {
        "type": "roughplastic",
        "distribution": "ggx",
        "alpha": 0.15,
        "int_ior": 1.5,
        "diffuse_reflectance": "reflectance",
    }
    return replace(scene, materials={**scene.materials, "white": replace(scene.materials["white"], bsdf=bsdf)})


def through_tent(size: int, seed: int) -> Side:
    """The box through a tent filter two pixels wide, from a picture of half the pixel size."""
    fine = rendered(cornell_box(), cornell_camera(2 * size), seed, samples=max(2, SAMPLES // 4))
    weights = np.array([1.0, 3.0, 3.0, 1.0]) / 8

    def filtered(picture: NDArray, kernel: NDArray) -> NDArray:
        for axis in (0, 1):
            pad = [(1, 1) if a == axis else (0, 0) for a in range(3)]
            wide = np.moveaxis(np.pad(picture, pad, mode="edge"), axis, 0)
            count = picture.shape[axis]
            total = sum(w * wide[k : k + count : 2] for k, w in enumerate(kernel))
            picture = np.moveaxis(total, 0, axis)
        return picture

    assert fine.variance is not None
    return replace(
        fine,
        radiance=filtered(fine.radiance, weights),
        variance=filtered(fine.variance, weights**2),
        surfaces=None,
    )


def pools(names: list[str]) -> dict[str, tuple[NDArray, Side]]:
    """By renderer: (batch, y, x, w) independent pictures of the box with a black lamp, and a side to fill."""
    camera = cornell_camera(POOL_SIZE)
    settings = ExportSettings(WAVELENGTHS, POOL_SAMPLES, POOL, subpixels=2)
    exported = exported_scene(cornell_box(), camera, settings).with_black_lamps
    image = render_image(RenderJob(exported.scene, camera, WAVELENGTHS, POOL_SAMPLES, POOL), integrator="path")
    blank = side_of([labelled_cube(image)], ["ours"])
    results = {"ours": (np.asarray(image.coefficients @ image.spectra, float), blank)}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "box"
        write_export(folder, exported)
        for name in names:
            if missing(name):
                print(missing(name))
                continue
            run_renderer(folder, name)
            pictures = np.asarray(renderer_of(name).read(folder / name, exported.layout), float)
            if renderer_of(name).pixels == "rays":
                shape = POOL, POOL_SIZE, settings.subpixels, POOL_SIZE, settings.subpixels, WAVELENGTHS.size
                pictures = pictures.reshape(shape).mean(axis=(2, 4))
            results[name] = pictures, replace(blank, source=name)
    return results


def across_renderers(pairs: int) -> None:
    """Print how many equal pictures of different renderers are distinguished."""
    pools_by_renderer, rng = pools(["mitsuba", "radiance", "raysect"]), np.random.default_rng(2027)
    wrong, failed, total = dict[tuple[str, str], int](), 0, dict[tuple[str, str], int]()

    def random_side(name: str) -> Side:
        pictures, blank = pools_by_renderer[name]
        four = pictures[rng.choice(POOL, BATCHES, replace=False)]
        mean, variance = four.mean(axis=0), four.var(axis=0, ddof=1) / BATCHES
        return replace(blank, radiance=mean, variance=variance, degrees=BATCHES - 1.0)

    for _ in range(pairs):
        first_name, other = sorted(rng.choice(list(pools_by_renderer), 2, replace=False).tolist())
        first, second = random_side(first_name), random_side(other)
        total[first_name, other] = total.get((first_name, other), 0) + 1
        wrong[first_name, other] = wrong.get((first_name, other), 0) + (not regress_sides(first, second)[0].same)
        failed += not pixel_rule(first, second)
    print(f"{pairs} pairs across renderers: false alarms {sum(wrong.values())}; per-pixel rule fails {failed}")
    for pair, count in total.items():
        print(f"  {' and '.join(pair)}: {wrong[pair]} of {count}")


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
    usual = 0.0
    print(f"{size} x {size}, {SAMPLES * BATCHES} samples per pixel, {seeds} seeds")
    for index, (name, change) in enumerate(changes.items()):
        detected, failed, sigmas, flips = 0, 0, [], []
        for run in range(seeds):
            candidate = change(1000 * (index + 1) + run)
            outcome = regress_sides(baseline, candidate)[0]
            detected += not outcome.same
            failed += not pixel_rule(baseline, candidate)
            sigmas.append(abs(outcome.picture_mean.statistic))
            flips.append(mean_flip(baseline, candidate))
        usual = max(flips) if index == 0 else usual
        print(
            f"{name:22s} seen {detected}/{seeds} (whole picture {np.median(sigmas):.1f} sigma, would have seen "
            f"{outcome.would_have_seen:.2%}); per-pixel rule fails {failed}/{seeds}; mean FLIP "
            f"{np.mean(flips):.4f}, above all unchanged ones {sum(f > usual for f in flips)}/{seeds}",
            flush=True,
        )


def naming(seeds: int, size: int, rows: str) -> None:
    """Print how often each change is named first, with the parameter asked for."""
    box, camera = cornell_box(), cornell_camera(size)
    off = replace(camera, principal_point_px=camera.principal_point_px + np.array([0.3, -0.5]))
    changes: dict[str, tuple[str, dict[str, object], Callable[[int], Side]]] = {
        "depth 3": ("path-depth", {"max_bounces": 3}, lambda seed: rendered(box, camera, seed, 3)),
        "depth 7": ("path-depth", {"max_bounces": 7}, lambda seed: rendered(box, camera, seed, 7)),
        "white paint x 1.01": (
            "paint",
            {"material": "white"},
            lambda seed: rendered(with_paint(box, "white", 1.01), camera, seed),
        ),
        "gloss of 0.04 on white": ("gloss", {"material": "white"}, lambda seed: rendered(with_coat(box), camera, seed)),
        "lamp x 1.02": ("lamp-scale", {}, lambda seed: scaled(rendered(box, camera, seed), 1.02)),
        "swapped walls": (
            "swapped-walls",
            {"surfaces": ["right", "left"]},
            lambda seed: rendered(with_swapped_walls(box), camera, seed),
        ),
        "tent filter": ("pixel-filter", {}, lambda seed: through_tent(size, seed)),
        "shift of (0.3; -0.5) px": ("shift", {}, lambda seed: rendered(box, off, seed)),
    }
    baseline = rendered(box, camera, 1)
    variants = build_variants(box, camera, baseline)
    print(f"{size} x {size}, {SAMPLES * BATCHES} samples per pixel, {seeds} seeds, the scene known")
    remember_pictures()
    for index, (name, (change, parameters, picture)) in enumerate(changes.items()):
        if rows and name not in rows.split(","):
            continue
        right, others, first = 0, [], None
        start = time.perf_counter()
        for run in range(seeds):
            outcome, compared = regress_sides(baseline, picture(50_000 * (index + 1) + run))
            change_named = None if outcome.same else named_changes(compared, variants)[0]
            is_right = (
                change_named is not None
                and change_named.change == change
                and parameters.items() <= dict(change_named.parameters).items()
            )
            right += is_right
            first = change_named if is_right and first is None else first
            if not is_right:
                others.append(
                    "same" if change_named is None else f"{change_named.change} {dict(change_named.parameters)}"
                )
        each = (time.perf_counter() - start) / seeds
        other_causes = (
            "" if first is None else f"; one of them {dict(first.parameters)}, probability {first.probability:.2f}"
        )
        print(f"{name:24s} named first {right}/{seeds}, {each:.0f} s each{other_causes}", flush=True)
        for other in others:
            print(f"    instead: {other}", flush=True)


def remember_pictures() -> None:
    """Pictures of the scene's changes are the same for all seeds: computed once, here and not in `cbox regress`."""
    plain, build, pictures = PatchLight.picture, Variants.rebuilt, dict[object, object]()

    def picture(light: PatchLight) -> NDArray:
        arrays = (
            light.patch_reflectance,
            light.fragment_reflectance,
            light.patch_emission,
            light.fragment_emission,
            light.wavelength_nm,
            light.added,
        )
        key = (id(light.transport), light.max_bounces, *map(digest, arrays))
        if key not in pictures:
            pictures[key] = plain(light)
        return pictures[key]  # type: ignore[return-value]

    def rebuilt(variants: Variants, scene: Scene) -> Variants:
        key = pickle.dumps(scene)
        if key not in pictures:
            pictures[key] = build(variants, scene)
        return pictures[key]  # type: ignore[return-value]

    PatchLight.picture = picture  # type: ignore[method-assign]
    Variants.rebuilt = rebuilt  # type: ignore[method-assign]


def digest(array: NDArray) -> bytes:
    """Of an array's values."""
    return hashlib.blake2b(np.ascontiguousarray(array), digest_size=16).digest()


def scaled(side: Side, factor: float) -> Side:
    """All light times a factor."""
    assert side.variance is not None
    return replace(side, radiance=factor * side.radiance, variance=factor**2 * side.variance)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=["alarms", "renderers", "power", "naming"])
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--rows", default="", help="Of naming, joined by commas; all where left out.")
    arguments = parser.parse_args()
    parts = {"alarms": alarms, "renderers": across_renderers}
    if arguments.part in parts:
        parts[arguments.part](arguments.pairs)
    elif arguments.part == "power":
        power(arguments.seeds, arguments.size)
    else:
        naming(arguments.seeds, arguments.size, arguments.rows)


if __name__ == "__main__":
    main()
