"""Spoilt pictures of the published box: how often `cbox regress` names the cause rightly, wrongly or not at all.

    python regress_spoilt.py            # all kinds
    python regress_spoilt.py developed  # kinds that were looked at while names were developed
    python regress_spoilt.py held-out   # kinds that were not

Each kind is planted in two or three sizes. Light by order of reflection, paints and geometry come from the path tracer
or from patch transport with other rays than the naming's; noise of 3 % a pixel in four batches is made up.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from cboxlab.rendering.effects import apply_checked, names_in
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import render_image
from cboxlab.rendering.model import labelled_cube
from cboxlab.scenes import Scene, cornell_box, cornell_camera
from cboxlab.validation.compare_renders.regress import UNKNOWN, Side, View, regress_pictures, side_of
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, median_filter

SIZE, BATCHES, NOISE = 64, 4, 0.03
WAVELENGTHS = np.arange(410.0, 701.0, 40.0)
#: Samples per pixel of the pictures that are spoilt.
SAMPLES = 512

Plant = tuple[set[str], Callable[[float], NDArray], tuple[float, ...]]


@cache
def clean(max_bounces: int | None = None) -> NDArray:
    """(y, x, w) radiance of the box."""
    return traced(cornell_box(), max_bounces)


def traced(scene: Scene, max_bounces: int | None = None) -> NDArray:
    """(y, x, w) radiance of a scene."""
    job = RenderJob(scene, cornell_camera(SIZE), WAVELENGTHS, SAMPLES, 2, seed=11, max_bounces=max_bounces)
    return np.asarray(side_of([labelled_cube(render_image(job, integrator="path"))], ["clean"]).radiance)


@cache
def surfaces() -> Side:
    """A side with the map of surfaces."""
    job = RenderJob(cornell_box(), cornell_camera(SIZE), WAVELENGTHS, 4, 2, seed=3)
    return side_of([labelled_cube(render_image(job, integrator="path"))], ["map"])


def noisy(picture: NDArray, seed: int) -> Side:
    """Side with skewed noise, nearly the same at all wavelengths; the lamp is quiet."""
    rng = np.random.default_rng(seed)
    visible = surfaces()
    assert visible.surfaces is not None
    shape = (BATCHES, SIZE, SIZE)
    common = np.where(visible.surfaces.lamp, 0.02, 1.0) * (rng.standard_gamma(1.0, shape) - 1)
    batch_noise = 0.15 * rng.standard_normal((*shape, WAVELENGTHS.size))
    values = picture * (1 + NOISE * np.sqrt(BATCHES) * (common[..., None] + batch_noise * np.abs(common[..., None])))
    mean, variance = values.mean(axis=0), values.var(axis=0, ddof=1) / BATCHES
    return replace(visible, source=f"seed {seed}", radiance=mean, variance=variance, degrees=BATCHES - 1.0)


def axes() -> tuple[NDArray, NDArray]:
    """(y, x) rows and columns from -1 to 1."""
    y, x = np.meshgrid(np.linspace(-1, 1, SIZE), np.linspace(-1, 1, SIZE), indexing="ij")
    return y[..., None], x[..., None]


def order(n: int) -> NDArray:
    """Light after n reflections."""
    return clean(n) - clean(n - 1)


def cosine() -> NDArray:
    rows, columns = np.indices((SIZE, SIZE))
    camera = cornell_camera(SIZE)
    return np.asarray((camera.directions(columns, rows) @ camera.rotation.T)[..., 2:])


def cells(edge: int) -> NDArray:
    """Checkerboard of -1 and 1."""
    rows, columns = np.indices((SIZE, SIZE))
    return np.where((rows // edge + columns // edge) % 2, 1.0, -1.0)[..., None]


def with_effect(name: str, **values: object) -> NDArray:
    """Picture of the box with an effect on its scene."""
    box = cornell_box()
    return traced(apply_checked(name, values, name, names_in(box)).apply(box))


def with_paint(name: str, factor: float) -> NDArray:
    box = cornell_box()
    paint = box.materials[name]
    changed = replace(paint, reflectance=paint.reflectance.scaled(factor))
    return traced(replace(box, materials={**box.materials, name: changed}))


def without_blocks_shadow(part: float) -> NDArray:
    box = cornell_box()
    bare = replace(box, surfaces=tuple(s for s in box.surfaces if not s.name.endswith("-block")))
    visible = surfaces().surfaces
    assert visible is not None
    walls = [n for n, name in enumerate(visible.names) if not name.endswith("-block")]
    more = np.maximum(traced(bare, 1) - clean(1), 0) * np.isin(visible.index, walls)[..., None]
    return clean() + part * more


def without_triangle(surface: str, number: int) -> NDArray:
    box = cornell_box()
    changed = tuple(
        replace(s, faces=np.delete(s.faces, number, axis=0)) if s.name == surface else s for s in box.surfaces
    )
    return traced(replace(box, surfaces=changed))


def swapped(a: str, b: str) -> NDArray:
    box = cornell_box()
    of = {s.name: s.material for s in box.surfaces}
    other = {a: of[b], b: of[a]}
    return traced(
        replace(box, surfaces=tuple(replace(s, material=other.get(s.name, s.material)) for s in box.surfaces))
    )


def lowered_lamp(by_mm: float) -> NDArray:
    box = cornell_box()
    surface = box.lamp.surface
    lower = replace(surface, vertices_mm=surface.vertices_mm - np.array([0, by_mm, 0]))
    return traced(replace(box, lamp=replace(box.lamp, surface=lower)))


def occluded(strength: float) -> NDArray:
    """Corners darkened as by a screen-space occlusion."""
    total = clean().sum(axis=-1)
    near = np.clip(gaussian_filter(np.log(total + 1e-6), 3) - np.log(total + 1e-6), 0, 1)
    return clean() * np.exp(-strength * near)[..., None]


def by_tiles(strength: float) -> NDArray:
    factors = np.random.default_rng(4).uniform(-1, 1, (SIZE // 16, SIZE // 16))
    return clean() * (1 + strength * np.kron(factors, np.ones((16, 16))))[..., None]


def pixels_black(count: float) -> NDArray:
    picture, rng = clean().copy(), np.random.default_rng(8)
    for _ in range(int(count)):
        picture[rng.integers(20, 60), rng.integers(8, 56)] = 0
    return picture


DEVELOPED: dict[str, Plant] = {
    "cos^n fall-off": ({"fall-off"}, lambda n: clean() * cosine() ** n, (4, 1.2)),
    "1 + a r^2": ({"fall-off"}, lambda a: clean() * (1 + a * (axes()[0] ** 2 + axes()[1] ** 2)), (-0.1, -0.03)),
    "gradient": ({"gradient"}, lambda a: clean() * (1 + a * axes()[1]), (0.05, 0.02)),
    "direct light again": ({"counted-light"}, lambda a: clean() + a * order(1), (1, 0.1)),
    "second reflection": ({"counted-light", "path-depth"}, lambda a: clean() + a * order(2), (1, -1, 0.2)),
    "third reflection": ({"counted-light"}, lambda a: clean() + a * order(3), (1, -1)),
    "no shadow": ({"no-shadow"}, without_blocks_shadow, (1, 0.5)),
    "block moved": ({"block-pose"}, lambda a: with_effect("block-pose", block="tall", dx_mm=a, dz_mm=0.0), (20, 6)),
    "lamp moved": ({"lamp-offset"}, lambda a: with_effect("lamp-offset", dx_mm=a, dz_mm=0.0), (40, 10)),
    "checkerboard": ({"pattern"}, lambda a: clean() * (1 + a * cells(2)), (0.3, 0.05)),
    "columns": ({"pattern"}, lambda a: clean() * (1 + a * (np.arange(SIZE) % 3 == 0)[:, None]), (-0.2, -0.05)),
    "median": ({"nonlinear-filter"}, lambda e: median_filter(clean(), (int(e), int(e), 1)), (3, 5)),
    "path depth": ({"path-depth", "counted-light"}, lambda n: clean(int(n)), (2, 4)),
}

HELD_OUT: dict[str, Plant] = {
    "rows": ({"pattern"}, lambda a: clean() * (1 + a * (np.arange(SIZE) % 2 * 2 - 1)[:, None, None]), (0.2, 0.05)),
    "tiles": ({"pattern"}, by_tiles, (0.3, 0.1)),
    "texture": (
        {"pattern"},
        lambda a: clean() * (1 + a * np.random.default_rng(2).standard_normal((SIZE, SIZE, 1))),
        (0.3, 0.1),
    ),
    "black pixels": ({"pattern"}, pixels_black, (8, 3)),
    "paint": ({"paint", "wall-reflectance"}, lambda f: with_paint("white", f), (0.97, 1.03)),
    "red paint": ({"paint", "wall-reflectance"}, lambda f: with_paint("red", f), (0.8, 1.3)),
    "lamp scaled": ({"lamp-scale"}, lambda f: f * clean(), (0.97, 1.02)),
    "offset": ({"offset"}, lambda a: clean() + a * clean().mean(), (0.02, -0.01)),
    "power": ({"power"}, lambda p: clean() ** p, (1.05, 0.97)),
    "mirrored": ({"mirrored"}, lambda a: clean()[:, ::-1], (1,)),
    "rolled": ({"shift"}, lambda n: np.roll(clean(), int(n), axis=1), (1, 3)),
    "swapped walls": ({"swapped-walls"}, lambda a: swapped("left", "right"), (1,)),
    "missing triangle": ({"missing-geometry"}, lambda n: without_triangle("tall-block", int(n)), (0, 3)),
    "lamp lower": ({"lamp-offset", "lamp-size"}, lowered_lamp, (1, 20)),
    "lamp reflectance": (
        {"lamp-reflectance"},
        lambda r: with_effect("lamp-reflectance", reflectance=r),
        (0.0, 0.4),
    ),
    "directional lamp": ({"lamp-directional"}, lambda n: with_effect("lamp-directional", exponent=n), (1.0, 0.2)),
    "blur": ({"pixel-filter"}, lambda s: gaussian_filter(clean(), (s, s, 0)), (0.6, 1.0)),
    "clipped": ({"clipped"}, lambda f: np.minimum(clean(), f * np.median(clean())), (3, 2)),
    "bands reversed": ({"wavelengths", "bands-exchanged"}, lambda a: clean()[..., ::-1], (1,)),
    # no name of the list: only `unknown` is right
    "occlusion": (set(), occluded, (0.5, 1.5)),
    "ripple": (set(), lambda a: clean() * (1 + a * np.sin(7 * axes()[0] + 3 * axes()[1])), (0.1, 0.04)),
    "vertical fog": (set(), lambda a: clean() * np.exp(a * axes()[0] ** 3) + 0.02 * a * clean().mean(), (0.2, 0.5)),
    "quadrant": (set(), lambda a: clean() * np.where((axes()[0] > 0) & (axes()[1] > 0), 1 + a, 1), (0.05, 0.2)),
    "direct gamma": (set(), lambda a: clean() + a * order(1) ** 2 / order(1).mean(), (0.05, 0.2)),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="?", default="all", choices=["all", "developed", "held-out"])
    parser.add_argument("--kinds", default="", help="Joined by commas; all where left out.")
    arguments = parser.parse_args()
    plants = {} if arguments.part == "held-out" else dict(DEVELOPED)
    plants |= {} if arguments.part == "developed" else HELD_OUT
    if arguments.kinds:
        plants = {name: plants[name] for name in arguments.kinds.split(",")}
    view = View(cornell_box(), cornell_camera(SIZE), True)
    counts = dict.fromkeys(("right", "unknown", "wrong", "same", "wrong above 0.9"), 0)
    probabilities: list[tuple[float, bool]] = []
    for number, (kind, (names, picture, sizes)) in enumerate(plants.items()):
        for run, size in enumerate(sizes):
            start = time.perf_counter()
            seeds = 1000 + 20 * number + 2 * run
            outcome = regress_pictures(noisy(clean(), seeds), noisy(picture(size), seeds + 1), view)
            first = outcome.changes[0] if outcome.changes else None
            if outcome.same or first is None:
                verdict = "same"
            elif "pattern" in names and outcome.cancelling:
                verdict = "right"
            elif first.change == UNKNOWN or not first.fits:
                verdict = "unknown"
            else:
                verdict = "right" if first.change in names else "wrong"
                probabilities.append((first.probability, verdict == "right"))
                counts["wrong above 0.9"] += verdict == "wrong" and first.probability > 0.9
            counts[verdict] += 1
            cause = "" if first is None else f"{first.change} {dict(first.parameters)} {first.probability:.2f}"
            best = outcome.best_name
            then = "" if best is None or best is first else f"; best {best.change} {best.probability:.2f}"
            left = f"{outcome.left_chi2_per_number:.2f}"
            seconds = time.perf_counter() - start
            print(f"{kind:20s} {size:6g} {verdict:8s} {cause}{then}; left {left}, {seconds:.0f} s", flush=True)
            if outcome.cancelling:
                print(f"{'':28s}pattern: {outcome.cancelling}", flush=True)
    print(", ".join(f"{name} {count}" for name, count in counts.items()))
    for low, high in ((0, 0.5), (0.5, 0.9), (0.9, 0.99), (0.99, 1.01)):
        inside = [right for probability, right in probabilities if low <= probability < high]
        if inside:
            print(f"stated {low} to {min(high, 1)}: {sum(inside)} of {len(inside)} right")


if __name__ == "__main__":
    main()
