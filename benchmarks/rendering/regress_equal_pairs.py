"""Equal pairs of pictures in `cbox regress`, by noise and scenes that its development did not use: false alarms.

    python regress_equal_pairs.py [--pairs 4] [--scenes caustic,night] [--seed 5]

Each of ten Mitsuba scenes is rendered some times with each sampler and filter. Pairs of these pictures go through the
same work on both sides: denoisers, sharpening, steps of files, fireflies, other numbers of samples. Verdicts alone are
asked for. Needs the package mitsuba; about ten minutes of one core.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.validation.compare_renders.regress import Side, regress_sides
from numpy.typing import NDArray
from regress_any_scene import SCENES, SIZE, T, area, box, paint, plane, seen_from
from scipy.ndimage import gaussian_filter, uniform_filter, zoom

Picture = NDArray[np.float64]


def caustic(rfilter: str) -> dict[str, Any]:
    ball = {"type": "sphere", "center": [0.0, -0.2, 0.2], "radius": 0.45, "bsdf": {"type": "roughdielectric"}}
    mirror = {"type": "sphere", "center": [-0.5, -0.7, 0.4], "radius": 0.3, "bsdf": {"type": "conductor"}}
    scene = {name: value for name, value in box(rfilter).items() if not name.endswith("-box")}
    return {**scene, "ball": ball, "mirror": mirror, "integrator": {"type": "path", "max_depth": 10}}


def night(rfilter: str) -> dict[str, Any]:
    lamps = {
        f"lamp-{n}": {
            "type": "sphere",
            "center": [1.5 * np.cos(n), 0.4 + 0.1 * n, 1.5 * np.sin(n)],
            "radius": 0.06,
            "emitter": area(3.0 + n, 5.0, 12.0 - n),
        }
        for n in range(9)
    }
    return {
        "type": "scene",
        "sensor": seen_from([0, 1.5, 4.5], [0, 0.5, 0], 50, rfilter),
        "ground": plane([0, 0, 0], [1, 0, 0], -90, 8, bsdf=paint(0.4, 0.4, 0.45)),
        "tower": {"type": "cube", "to_world": T().translate([0, 0.6, 0]).scale([0.4, 0.6, 0.4])},
        "integrator": {"type": "path", "max_depth": 5},
        **lamps,
    }


def grid(rfilter: str) -> dict[str, Any]:
    balls = {
        f"ball-{x}-{y}": {
            "type": "sphere",
            "center": [0.6 * x, 0.6 * y, 0.0],
            "radius": 0.26,
            "bsdf": {"type": "roughplastic", "alpha": 0.05 + 0.04 * (x + 2)},
        }
        for x, y in itertools.product(range(-2, 3), repeat=2)
    }
    return {
        "type": "scene",
        "sensor": seen_from([0, 0, 5], [0, 0, 0], 40, rfilter),
        "wall": plane([0, 0, -0.5], [0, 1, 0], 0, 4, bsdf=paint(0.6, 0.5, 0.3)),
        "lamp": plane([2, 3, 3], [1, 0, 0], 120, 0.7, emitter=area(20, 20, 20)),
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.1, 0.1, 0.1]}},
        "integrator": {"type": "path", "max_depth": 6},
        **balls,
    }


#: Renderings: sampler, filter, samples a pixel.
RENDERED = {
    "multijitter": ("multijitter", "tent", 16),
    "quasi-random": ("ldsampler", "box", 64),
    "lanczos": ("independent", "lanczos", 16),
    "one sample": ("independent", "box", 1),
    "orthogonal": ("orthogonal", "mitchell", 25),
}


def means_of_alike(picture: Picture) -> Picture:
    """Means over 7 x 7 pixels, weighted by the likeness of their 3 x 3 surroundings (non-local means)."""
    total, weights = np.zeros_like(picture), np.zeros(picture.shape[:2])
    scale = np.median(np.abs(picture - gaussian_filter(picture, (1, 1, 0)))) + 1e-9
    for shift in itertools.product(range(-3, 4), repeat=2):
        moved = np.roll(picture, shift, (0, 1))
        weight = np.exp(-uniform_filter(((moved - picture) ** 2).sum(axis=-1), 3) / (6 * scale) ** 2)
        total, weights = total + weight[..., None] * moved, weights + weight
    return total / weights[..., None]


def shared_exponent(picture: Picture) -> Picture:
    """RGBE without a statement of its steps."""
    largest = np.maximum(picture.max(axis=-1, keepdims=True), 1e-9)
    step = 2.0 ** (np.floor(np.log2(largest)) - 7)
    return np.floor(np.maximum(picture, 0) / step) * step + 0.5 * step


def halved(picture: Picture) -> Picture:
    """Means of 2 x 2 pixels, enlarged again."""
    small = picture.reshape(SIZE // 2, 2, SIZE // 2, 2, 3).mean(axis=(1, 3))
    return np.asarray(zoom(small, (2, 2, 1), order=1))


def with_fireflies(picture: Picture) -> Picture:
    """Some pixels brighter by a Cauchy distributed part."""
    rng = np.random.default_rng(int(1e6 * picture.mean()) % 2**31)
    hit = rng.random(picture.shape[:2]) < 0.004
    return picture + (hit * np.abs(rng.standard_cauchy(hit.shape)))[..., None] * picture.mean()


#: Work on both pictures.
WORK: dict[str, Callable[[Picture], Picture]] = {
    "none": lambda p: p,
    "non-local means": means_of_alike,
    "sharpened": lambda p: 1.6 * p - 0.6 * gaussian_filter(p, (1, 1, 0)),
    "half size and back": halved,
    "shared exponent": shared_exponent,
    "eight bits": lambda p: (np.round(255 * np.clip(p, 0, 1) ** (1 / 2.2)) / 255) ** 2.2,
    "fireflies": with_fireflies,
    "logarithms smoothed": lambda p: np.exp(gaussian_filter(np.log(np.maximum(p, 1e-4)), (1.5, 1.5, 0))),
    "medians of three": lambda p: np.median([np.roll(p, n, axis=1) for n in (-1, 0, 1)], axis=0),
}


def pictures(build: Callable[[str], dict[str, Any]], kind: str, count: int, first: int, seed: int) -> list[Picture]:
    """Independent renderings."""
    sampler, rfilter, samples = RENDERED[kind]
    scene = build(rfilter)
    scene["sensor"]["sampler"] = {"type": sampler}
    loaded, rendered = mi.load_dict(scene), []
    for number in range(count):
        mi.render(loaded, spp=samples, seed=104729 * (first + number) + 7 + seed)
        bitmap = loaded.sensors()[0].film().bitmap()
        planes = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
        rendered.append(np.array(planes).astype(float))
    return rendered


def side(picture: Picture) -> Side:
    """R, G, B without stated errors."""
    return Side("pair", np.full(3, np.nan), picture, None, 0.0, None, in_colour=True, colours=("R", "G", "B"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=1, help="Of each scene, rendering and work.")
    scenes = {**SCENES, "caustic": caustic, "night": night, "grid": grid}
    parser.add_argument("--scenes", default=",".join(scenes))
    parser.add_argument("--seed", type=int, default=0, help="Added to the seeds of the renderings.")
    options = parser.parse_args()
    total, alarms, start = 0, 0, time.process_time()
    for number, name in enumerate(options.scenes.split(",")):
        for kind in RENDERED:
            count = 2 * options.pairs
            rendered = pictures(scenes[name], kind, count, 1000 * number, options.seed)
            for work, function in WORK.items():
                for first, second in zip(rendered[::2], rendered[1::2], strict=True):
                    try:
                        outcome, _ = regress_sides(side(function(first)), side(function(second)))
                    except InputError:  # sharpened pictures of one sample have much light below 0
                        continue
                    total, alarms = total + 1, alarms + (not outcome.same)
                    if not outcome.same:
                        row = outcome.deciding[0]
                        print(f"{name}, {kind}, {work}: {row.kind} {row.name}, {row.statistic:.1f}", flush=True)
        print(f"{name}: {alarms} alarms in {total} pairs, {time.process_time() - start:.0f} CPU seconds", flush=True)
    print(f"{alarms} alarms in {total} equal pairs")


if __name__ == "__main__":
    main()
