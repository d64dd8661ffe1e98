"""Pictures of Mitsuba's own scenes in `cbox regress`: false alarms of equal pairs, names of spoilt ones.

    python regress_any_scene.py equal   [--scenes box,hair] [--runs 2]
    python regress_any_scene.py spoilt  [--scenes interior,outdoor]
    python regress_any_scene.py unlisted [--scenes interior,textured]

Equal pairs differ in their seeds: single pictures with and without AOVs, batches, filters, a denoiser on both sides,
half floats. Spoilt pictures are renderings of another seed with one change. Changes of unlisted ones were made up after
the names were finished. Needs the package mitsuba.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import OpenEXR
from cboxlab.validation.compare_renders.regress import UNKNOWN, Outcome, regress_inputs
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, median_filter, uniform_filter1d, zoom

mi.set_variant("scalar_rgb")  # pictures this small are rendered before a kernel is compiled
SIZE = 48
SPOILT_SAMPLES = 64
Picture = NDArray[np.float64]
T = mi.ScalarTransform4f


def film(rfilter: str) -> dict[str, Any]:
    kind = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "pixel_format": "rgb", "component_format": "float32"}
    return {**kind, "rfilter": {"type": rfilter}}


def seen_from(origin: list[float], target: list[float], fov: float, rfilter: str) -> dict[str, Any]:
    pose = T().look_at(origin=origin, target=target, up=[0, 1, 0])
    sampler = {"type": "independent"}
    return {"type": "perspective", "fov": fov, "to_world": pose, "film": film(rfilter), "sampler": sampler}


def paint(*values: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(values)}}


def plane(move: list[float], axis: list[int], degrees: float, size: float, **more: Any) -> dict[str, Any]:
    return {"type": "rectangle", "to_world": T().translate(move).rotate(axis, degrees).scale(size), **more}


def area(*values: float) -> dict[str, Any]:
    return {"type": "area", "radiance": {"type": "rgb", "value": list(values)}}


def box(rfilter: str) -> dict[str, Any]:
    scene = mi.cornell_box()
    scene["sensor"] |= {"film": film(rfilter), "sampler": {"type": "independent"}}
    return dict(scene)


def glass(rfilter: str) -> dict[str, Any]:
    ball = {"type": "sphere", "center": [0.3, -0.6, 0.4], "radius": 0.38, "bsdf": {"type": "dielectric"}}
    return {**box(rfilter), "small-box": ball, "integrator": {"type": "path", "max_depth": 12}}


def volume(rfilter: str) -> dict[str, Any]:
    medium = {"type": "homogeneous", "albedo": 0.8, "sigma_t": 0.4}
    fog = {"type": "cube", "to_world": T().scale(0.98), "bsdf": {"type": "null"}, "interior": medium}
    return {**box(rfilter), "fog": fog, "integrator": {"type": "volpath", "max_depth": 8}}


def hair(rfilter: str) -> dict[str, Any]:
    rng, scene = np.random.default_rng(1), box(rfilter)
    for number in range(60):
        x, z = rng.uniform(-0.7, 0.7, 2)
        tip = [x + rng.normal(0, 0.1), 0.6, z + rng.normal(0, 0.1)]
        shape = {"type": "cylinder", "p0": [x, -1, z], "p1": tip, "radius": 0.012}
        scene[f"hair-{number}"] = {**shape, "bsdf": paint(0.4, 0.25, 0.1)}
    return {name: value for name, value in scene.items() if not name.endswith("-box")}


def interior(rfilter: str) -> dict[str, Any]:
    plastic = {"type": "roughplastic", "alpha": 0.15}
    return {
        "type": "scene",
        "sensor": seen_from([0, 1.4, 3.5], [0, 1, 0], 60, rfilter),
        "floor": plane([0, 0, 0], [1, 0, 0], -90, 3, bsdf=paint(0.5, 0.4, 0.3)),
        "ceiling": plane([0, 2.6, 0], [1, 0, 0], 90, 3, bsdf=paint(0.8, 0.8, 0.8)),
        "back": plane([0, 1, -2], [0, 1, 0], 0, 3, bsdf=paint(0.7, 0.6, 0.5)),
        "left": plane([-2.5, 1, 0], [0, 1, 0], 90, 3, bsdf=paint(0.3, 0.5, 0.7)),
        "right": plane([2.5, 1, 0], [0, 1, 0], -90, 3, bsdf=paint(0.6, 0.6, 0.3)),
        "table": {"type": "cube", "to_world": T().translate([0.3, 0.4, -0.4]).scale([0.8, 0.05, 0.5]), "bsdf": plastic},
        "ball": {"type": "sphere", "center": [-0.9, 0.45, -0.2], "radius": 0.45, "bsdf": {"type": "roughconductor"}},
        "lamp": plane([0.5, 2.55, 0.2], [1, 0, 0], 90, 0.4, emitter=area(12, 11, 9)),
        "integrator": {"type": "path", "max_depth": 8},
    }


def textured(rfilter: str) -> dict[str, Any]:
    texels = mi.Bitmap(np.random.default_rng(3).uniform(0.1, 0.9, (64, 64, 3)).astype(np.float32))
    wood = {"type": "diffuse", "reflectance": {"type": "bitmap", "bitmap": texels, "raw": True}}
    squares = {"type": "diffuse", "reflectance": {"type": "checkerboard", "to_uv": T().scale([8, 8, 1])}}
    return {
        "type": "scene",
        "sensor": seen_from([0, 2, 3], [0, 0, 0], 50, rfilter),
        "floor": plane([0, 0, 0], [1, 0, 0], -90, 3, bsdf=wood),
        "ball": {"type": "sphere", "center": [0, 0.6, 0], "radius": 0.6, "bsdf": squares},
        "lamp": plane([1, 3, 1], [1, 0, 0], 90, 0.5, emitter=area(15, 15, 15)),
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.2, 0.25, 0.3]}},
        "integrator": {"type": "path", "max_depth": 6},
    }


def outdoor(rfilter: str) -> dict[str, Any]:
    house = T().translate([-1, 0.8, 0]).scale([0.9, 0.8, 0.8])
    return {
        "type": "scene",
        "sensor": seen_from([0, 1.5, 6], [0, 1, 0], 45, rfilter),
        "ground": plane([0, 0, 0], [1, 0, 0], -90, 50, bsdf=paint(0.3, 0.35, 0.2)),
        "house": {"type": "cube", "to_world": house, "bsdf": paint(0.7, 0.6, 0.5)},
        "tree": {"type": "sphere", "center": [1.6, 1.3, 0.4], "radius": 0.8, "bsdf": paint(0.1, 0.4, 0.1)},
        "sky": {"type": "sunsky", "sun_direction": [0.5, 0.6, 0.4]},
        "integrator": {"type": "path", "max_depth": 6},
    }


SCENES = {f.__name__: f for f in (box, glass, volume, hair, interior, textured, outdoor)}


def denoised(picture: Picture) -> Picture:
    """Means of logarithms over 5 x 5 pixels, similar ones weighted most."""
    logs = np.log(np.maximum(picture, 1e-4))
    smooth = gaussian_filter(logs, (1, 1, 0))
    total, weights = 0 * logs, 1e-9 + 0 * logs
    for shift in itertools.product(range(-2, 3), repeat=2):
        moved = np.roll(logs, shift, (0, 1))
        weight = np.exp(-((moved - smooth) ** 2) / 0.1)
        total, weights = total + weight * moved, weights + weight
    return np.asarray(np.exp(total / weights))


#: By kind of noise: filter, AOVs, samples per pixel, batches, work on the finished picture.
NOISE: dict[str, tuple[str, str, int, int, Callable[[Picture], Picture] | None]] = {
    "single": ("box", "", 32, 1, None),
    "single with AOVs": ("gaussian", "alb:albedo,nn:sh_normal,dd:depth", 32, 1, None),
    "few batches": ("box", "", 16, 3, None),
    "batches, filtered": ("gaussian", "idx:shape_index", 16, 5, None),
    "four samples": ("box", "", 4, 1, None),
    "wide filter": ("gaussian", "", 32, 1, lambda p: gaussian_filter(p, (1, 1, 0))),
    "denoised": ("box", "alb:albedo,nn:sh_normal", 16, 1, denoised),
    "median": ("box", "", 32, 1, lambda p: median_filter(p, (3, 3, 1))),
    "half floats": ("tent", "", 64, 1, lambda p: np.minimum(p, 65000).astype(np.float16).astype(float)),
}

Y, X = (axis[..., None] for axis in np.meshgrid(*2 * [np.linspace(-1, 1, SIZE)], indexing="ij"))
CHECKED = np.where(np.indices((SIZE, SIZE)).sum(axis=0) % 2, 1.0, -1.0)[..., None]
#: By kind: changes that name it, none where only `unknown` is right; the spoilt picture.
SPOILT: dict[str, tuple[set[str], Callable[[Picture], Picture]]] = {
    "scaled": ({"lamp-scale"}, lambda p: 1.05 * p),
    "gains": ({"channel-gains"}, lambda p: p * [1.08, 1.0, 0.93]),
    "gamma": ({"power"}, lambda p: p ** (1 / 2.2)),
    "power": ({"power"}, lambda p: p**1.1),
    "clamp": ({"clipped"}, lambda p: np.minimum(p, 1.5 * np.median(p))),
    "moved": ({"shift"}, lambda p: np.concatenate([p[:, :1], p[:, :-1]], axis=1)),
    "rolled": ({"shift"}, lambda p: np.roll(p, 20, axis=1)),
    "mirrored": ({"mirrored"}, lambda p: p[:, ::-1]),
    "blurred": ({"pixel-filter"}, lambda p: gaussian_filter(p, (0.8, 0.8, 0))),
    "offset": ({"offset"}, lambda p: p + 0.03 * p.mean()),
    "exchanged": ({"bands-exchanged"}, lambda p: p[..., ::-1]),
    "gradient": ({"gradient"}, lambda p: p * (1 + 0.08 * X)),
    "checkerboard": ({"pattern"}, lambda p: p * (1 + 0.2 * CHECKED)),
    "ripple": (set(), lambda p: p * (1 + 0.1 * np.sin(7 * Y + 3 * X))),
    "quadrant": (set(), lambda p: p * np.where((X > 0) & (Y > 0), 1.12, 1.0)),
}


def curved(picture: Picture, strength: float) -> Picture:
    """A film's curve on values over their mean."""
    x = picture / picture.mean()
    return picture * (1 + strength) / (1 + strength * x)


def one_channel(picture: Picture, number: int, of: Callable[[Picture], Picture]) -> Picture:
    changed = picture.copy()
    changed[..., number] = of(picture[..., number])
    return changed


def tile_of_neighbour(picture: Picture) -> Picture:
    changed = picture.copy()
    changed[16:28, 16:28] = picture[16:28, 28:40]
    return changed


def stretched(picture: Picture) -> Picture:
    return np.asarray(zoom(picture, (1, 52 / 48, 1), order=1)[:, 2:50])


LIGHT = np.array([0.2126, 0.7152, 0.0722])
#: Kinds that no list had, in the form of ``SPOILT``.
UNLISTED: dict[str, tuple[set[str], Callable[[Picture], Picture]]] = {
    "gamma of one channel": (set(), lambda p: one_channel(p, 0, lambda c: c**1.2)),
    "channels exchanged": ({"bands-exchanged"}, lambda p: p[..., [1, 0, 2]]),
    "colours paler": (set(), lambda p: 0.8 * p + 0.2 * (p @ LIGHT)[..., None]),
    "film curve": (set(), lambda p: curved(p, 0.3)),
    "toe": (set(), lambda p: p * (1 - np.exp(-p / (0.3 * p.mean())))),
    "black crushed": (set(), lambda p: np.maximum(p - 0.1 * p.mean(), 0)),
    "glare": (set(), lambda p: 0.9 * p + 0.1 * gaussian_filter(p, (6, 6, 0))),
    "flare": (set(), lambda p: p + 0.3 * p.mean() * np.exp(-((X - 0.2) ** 2 + (Y + 0.3) ** 2) / 0.05)),
    "motion": (set(), lambda p: uniform_filter1d(p, 5, axis=1)),
    "local contrast": (set(), lambda p: p * (gaussian_filter(p, (5, 5, 0)) / p.mean()) ** -0.2),
    "halo": ({"pixel-filter"}, lambda p: 1.5 * p - 0.5 * gaussian_filter(p, (1.5, 1.5, 0))),
    "seams": ({"pattern"}, lambda p: p * np.where((np.arange(SIZE) % 12 == 0)[:, None, None], 1.15, 1.0)),
    "tile of its neighbour": ({"pattern"}, tile_of_neighbour),
    "rows of an earlier frame": ({"border", "pattern"}, lambda p: np.concatenate([p[:40], 0.8 * p[40:]])),
    "odd rows moved": ({"pattern"}, lambda p: np.stack([np.roll(r, n % 2, axis=0) for n, r in enumerate(p)])),
    "colour by height": (set(), lambda p: p * (1 + 0.15 * Y * [1, 0, -1])),
    "one corner dark": (set(), lambda p: p * (1 - 0.3 * np.clip(X + Y - 0.8, 0, 1))),
    "fog": (set(), lambda p: p * np.exp(-0.3 * (1 - Y)) + 0.1 * p.mean() * (1 - Y)),
    "half size": (set(), lambda p: np.kron(p.reshape(24, 2, 24, 2, 3).mean(axis=(1, 3)), np.ones((2, 2, 1)))),
    "stretched": (set(), stretched),
    "colour fringes": (set(), lambda p: np.stack([np.roll(p[..., n], n - 1, axis=1) for n in range(3)], axis=-1)),
    "NaN as 0": (
        {"pattern"},
        lambda p: np.where(np.add.outer(7 * np.arange(SIZE), np.arange(SIZE))[..., None] % 97 == 0, 0, p),
    ),
    "ring": (set(), lambda p: p * (1 + 0.2 * np.exp(-((np.hypot(X, Y) - 0.6) ** 2) / 0.005))),
    "middle blurred": (set(), lambda p: np.where(np.hypot(X, Y) < 0.5, gaussian_filter(p, (1.5, 1.5, 0)), p)),
    "texture smoothed": (set(), lambda p: np.where(Y > 0, gaussian_filter(p, (1, 1, 0)), p)),
    "dither": ({"pattern"}, lambda p: p + 0.1 * p.mean() * np.tile([[0, 0.5], [0.75, 0.25]], (24, 24))[..., None]),
    "bright samples brighter": (set(), lambda p: p + 0.1 * np.maximum(p - 2 * p.mean(), 0)),
    "levels reversed": (set(), lambda p: p.max() * 0.2 - 0.1 * p + 0.5 * p.mean()),
    "grey": (set(), lambda p: np.repeat((p @ LIGHT)[..., None], 3, axis=-1)),
    "colour matrix": (set(), lambda p: p @ np.array([[0.9, 0.05, 0.05], [0.1, 0.85, 0.05], [0.0, 0.1, 0.9]]).T),
    "white noise of a sensor": (
        set(),
        lambda p: p * (1 + 0.3 * np.random.default_rng(2).standard_normal((SIZE, SIZE, 1))),
    ),
    "light of the left half again": (set(), lambda p: p + 0.1 * p[:, ::-1]),
}


def built(name: str, rfilter: str, aovs: str) -> Any:
    scene = SCENES[name](rfilter)
    if aovs:
        scene["integrator"] = {"type": "aov", "aovs": aovs, "picture": scene["integrator"]}
    return mi.load_dict(scene)


def rendered(scene: Any, seed: int, samples: int, path: Path, work: Callable[[Picture], Picture] | None) -> str:
    """File of a rendering."""
    mi.render(scene, spp=samples, seed=seed)
    scene.sensors()[0].film().bitmap().write(str(path))
    if work is not None:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            planes = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
        picture = work(np.stack([planes[name] for name in "RGB"], axis=-1).astype(float))
        planes |= {name: np.ascontiguousarray(picture[..., i], np.float32) for i, name in enumerate("RGB")}
        OpenEXR.File({"type": OpenEXR.scanlineimage}, planes).write(str(path))
    return str(path)


def equal(scenes: list[str], runs: int, folder: Path) -> None:
    pairs, alarms, seed = 0, 0, 0
    for name, (kind, (rfilter, aovs, samples, batches, work)) in itertools.product(scenes, NOISE.items()):
        scene = built(name, rfilter, aovs)
        for _ in range(runs):
            sides = []
            for side in range(2):
                files = []
                for batch in range(batches):
                    seed += 1
                    files.append(rendered(scene, 7919 * seed, samples, folder / f"{side}-{batch}.exr", work))
                sides.append(",".join(files))
            outcome = regress_inputs(*sides)
            pairs, alarms = pairs + 1, alarms + (not outcome.same)
            if not outcome.same:
                print(f"{name}, {kind}: {outcome.deciding[0].kind} {outcome.deciding[0].name}", flush=True)
    print(f"{alarms} alarms in {pairs} equal pairs")


def judged(outcome: Outcome, names: set[str]) -> str:
    """Verdict on a verdict."""
    if outcome.same:
        return "same"
    if "pattern" in names and outcome.cancelling:
        return "right"
    first = outcome.changes[0]
    if first.change == UNKNOWN or not first.fits:
        return "unknown" if names else "right"
    return "right" if first.change in names else "wrong"


def spoilt(scenes: list[str], folder: Path, kinds: dict[str, tuple[set[str], Callable[[Picture], Picture]]]) -> None:
    counts = dict.fromkeys(("right", "unknown", "wrong", "same", "wrong above 0.9"), 0)
    for name in scenes:
        scene = built(name, "gaussian", "")
        baseline = rendered(scene, 1, SPOILT_SAMPLES, folder / "baseline.exr", None)
        for kind, (names, work) in kinds.items():
            start = time.perf_counter()
            outcome = regress_inputs(baseline, rendered(scene, 2, SPOILT_SAMPLES, folder / "candidate.exr", work))
            verdict = judged(outcome, names)
            counts[verdict] += 1
            best = outcome.best_name
            high = best is not None and best.probability > 0.9 and best.change not in names
            counts["wrong above 0.9"] += high
            said = ", ".join(f"{n.change} {n.probability:.2f}{' fits' * n.fits}" for n in outcome.changes[:2])
            print(f"{name:10s} {kind:28s} {verdict:8s} {said} ({time.perf_counter() - start:.0f} s)", flush=True)
    print(", ".join(f"{verdict} {count}" for verdict, count in counts.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=["equal", "spoilt", "unlisted"])
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--runs", type=int, default=2)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if options.part == "equal":
            equal(options.scenes.split(","), options.runs, Path(folder))
        else:
            kinds = UNLISTED if options.part == "unlisted" else SPOILT
            spoilt(options.scenes.split(","), Path(folder), kinds)


if __name__ == "__main__":
    main()
