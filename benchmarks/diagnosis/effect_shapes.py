"""How well the diagnosis knows each effect's shape: its predicted change against an independent one.

    python benchmarks/diagnosis/effect_shapes.py [--effects haze,gloss] [--size 32] [--samples 4096] [--json]

The published box and camera, a lamp of radiance 1, three wavelengths, pixels inside faces away from the lamp. The
prediction is the diagnosis' own: patches of a twelfth of the box's diagonal. Effects of light transport are compared
with Mitsuba's path and volpath integrators (tests/oracles), those of lamp and geometry with a final gather of
the altered box, truncated light with the path tracer. "error" is the rms of predicted less true change over pixels
and wavelengths, over the rms of the true change, the references' Monte Carlo variance taken off both (0 where it is
all there is); "shape" is the same with the best amplitude, which "amplitude" is; "noise" that of the reference,
over the change. On two cores the whole takes about half an hour. --json prints one JSON object last.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.perturbation.patch_light import PatchLight, patch_light
from cboxlab.rendering.radiosity.final_gather import render_final_gather
from cboxlab.scenes import Spectrum, cornell_box, cornell_camera
from cboxlab.validation.predict import predictor
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from oracles import mitsuba_effects

NM, GRID = np.array([450.0, 550.0, 650.0]), np.arange(400.0, 701.0)

CASES: list[tuple[str, dict[str, Any]]] = [
    ("haze", {"extinction_per_m": 0.02, "albedo": 0.9}),
    ("haze", {"extinction_per_m": 0.2, "albedo": 0.3}),
    ("haze", {"extinction_per_m": 0.3, "albedo": 1.0}),
    ("rough-diffuse", {"material": "white", "sigma_rad": 0.4}),
    ("rough-diffuse", {"material": "red", "sigma_rad": 0.8}),
    ("gloss", {"material": "white", "specular": 0.3, "roughness": 0.25}),
    ("gloss", {"material": "white", "specular": 0.3, "roughness": 0.1}),
    ("gloss", {"material": "green", "specular": 1.0, "roughness": 0.2}),
    ("ambient-light", {"radiance": 0.005, "spectrum": "daylight"}),
    ("interreflection", {"max_bounces": 1.0}),
    ("interreflection", {"max_bounces": 2.0}),
    ("lamp-nonuniform", {"edge_ratio": 0.3}),
    ("lamp-directional", {"exponent": 0.5}),
    ("lamp-offset", {"dx_mm": 15.0, "dz_mm": -10.0}),
    ("block-pose", {"block": "tall", "dx_mm": 8.0, "dz_mm": 0.0, "yaw_deg": 1.0}),
    ("wall-reflectance", {"material": "red", "scale": 1.2}),
]


class Bench:
    """The effect-free box: its picture, what the diagnosis' patches say, and which pixels count."""

    def __init__(self, size: int, samples: int, batches: int) -> None:
        self.samples, self.batches = samples, batches
        self.camera = cornell_camera(size)
        self.scene = cornell_box().with_lamp(Spectrum(np.array([300.0, 900.0]), np.ones(2)))
        self.picture, _, image = self.gathered(self.scene)
        self.used = image.single_surface & (image.surface >= 0) & ~binary_dilation(image.sees_lamp, np.ones((3, 3)))
        self.before = self.light(self.scene).picture()

    def gathered(self, scene: Any) -> tuple[NDArray, NDArray, Any]:
        image = render_final_gather(RenderJob(scene, self.camera, NM, 2048, 8, seed=11))
        mean, variance = (np.moveaxis(x, -1, 0) for x in image.project(np.eye(3)))
        return mean, variance, image

    def light(self, scene: Any, max_bounces: int | None = None) -> PatchLight:
        transport = predictor.coarse_transport(scene, self.camera, 0)
        at_each = (GRID == NM[:, None]).astype(float)
        return patch_light(transport, scene, NM, GRID, at_each, np.ones(GRID.size), max_bounces=max_bounces)

    def truth(self, name: str, values: dict[str, Any]) -> tuple[NDArray, NDArray, NDArray]:
        """The picture with the effect, its variance, and which pixels see what they saw."""
        reference: Callable = mitsuba_effects.reference
        common = (self.scene, self.camera, NM, self.samples)
        if name == "haze":
            air = mitsuba_effects.haze(self.scene, self.camera, **values)
            return (*reference(*common, batches=self.batches, air=air), self.used)
        if name == "rough-diffuse":
            paint = (values["material"], mitsuba_effects.oren_nayar(values["sigma_rad"]))
            return (*reference(*common, batches=self.batches, paint=paint), self.used)
        if name == "gloss":
            paint = (values["material"], mitsuba_effects.coat(values["specular"], values["roughness"]))
            return (*reference(*common, batches=self.batches, paint=paint), self.used)
        if name == "ambient-light":  # at one wavelength the surround is 1 at 550 nm; the others follow its spectrum
            applied = apply_checked(name, values, "benchmark").apply(self.light(self.scene))
            plain, noise = reference(*common, batches=self.batches, surround=values["radiance"])
            share = (applied.surround / values["radiance"])[:, None, None]
            return self.picture + (plain - self.picture) * share, noise * share**2, self.used
        if name == "interreflection":
            bounces = int(values["max_bounces"])
            image = render_path_tracer(
                RenderJob(self.scene, self.camera, NM, self.samples, self.batches, seed=3, max_bounces=bounces)
            )
            mean, variance = (np.moveaxis(x, -1, 0) for x in image.project(np.eye(3)))
            return mean, variance, self.used
        mean, variance, image = self.gathered(apply_checked(name, values, "benchmark").apply(self.scene))
        return (
            mean,
            variance,
            self.used & image.single_surface & ~binary_dilation(image.sees_lamp, np.ones((3, 3))),
        )

    def predicted(self, name: str, values: dict[str, Any]) -> NDArray:
        """The picture with the effect as the diagnosis predicts it."""
        applied = apply_checked(name, values, "benchmark")
        if applied.stage == "transport":
            after = applied.apply(self.light(self.scene)).picture()
        elif applied.stage == "settings":
            after = self.light(self.scene, int(values["max_bounces"])).picture()
        else:
            after = self.light(applied.apply(self.scene)).picture()
        return predictor.with_change_of(self.picture, self.before, after, None)

    def row(self, name: str, values: dict[str, Any]) -> dict[str, Any]:
        """What the table says of one effect."""
        start = time.perf_counter()
        mean, variance, used = self.truth(name, values)
        used = used & np.isfinite(mean).all(axis=0)
        change, guess = (x[:, used] - self.picture[:, used] for x in (mean, self.predicted(name, values)))
        noise = float(variance[:, used].mean())
        size = max(float((change**2).mean()) - noise, 1e-30)
        amplitude = float(np.sum(guess * change) / np.sum(guess**2))

        def error(difference: NDArray) -> float:
            return float(np.sqrt(max(float((difference**2).mean()) - noise, 0.0) / size))

        return {
            "effect": name,
            "values": values,
            "change": float(np.sqrt(size) / self.picture[:, used].mean()),
            "error": error(guess - change),
            "shape": error(amplitude * guess - change),
            "amplitude": amplitude,
            "noise": float(np.sqrt(noise / size)),
            "seconds": time.perf_counter() - start,
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effects", default="")
    parser.add_argument("--size", type=int, default=32)
    parser.add_argument("--samples", type=int, default=4096)
    parser.add_argument("--batches", type=int, default=8)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    bench = Bench(options.size, options.samples, options.batches)
    rows = []
    print(f"{'effect':64s} {'change':>8s} {'error':>7s} {'shape':>7s} {'amplitude':>9s} {'noise':>7s}")
    for name, values in CASES:
        if not options.effects or name in options.effects.split(","):
            row = bench.row(name, values)
            rows.append(row)
            label = f"{name} {', '.join(f'{k}={v}' for k, v in values.items())}"
            print(
                f"{label:64s} {row['change']:8.2%} {row['error']:7.1%} {row['shape']:7.1%} {row['amplitude']:9.3f} "
                f"{row['noise']:7.1%}",
                flush=True,
            )
    if options.json:
        print(json.dumps(rows))


if __name__ == "__main__":
    main()
