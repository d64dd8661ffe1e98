"""Every integrator against stock Mitsuba, in five boxes: mean radiance of each surface, over its standard error.

    python benchmarks/rendering/against_stock.py [--size 32] [--samples 512]

Boxes: the published one; with a ball on each block; with a mesh of 99,904 triangles in place of the short
block; with a rough coat on all that is white; in haze. Three bands, 16 batches of --samples paths a pixel for stock
and for each of ours; pixels that see one surface alone. Printed for each: the root mean square of all differences
over their standard errors (1.04 is expected of 16 batches each), the largest of them, the largest relative difference
with its standard error, and the median standard error of a surface's mean.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import trimesh
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.image.image import RenderedImage
from cboxlab.rendering.integrators.general_path_tracer import render_general_path_tracer
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.integrators.stock import render_stock
from cboxlab.rendering.radiosity.final_gather import render_final_gather
from cboxlab.scenes import Medium, Scene, Spectrum, Surface, cornell_box, cornell_camera
from cboxlab.scenes.shapes import sphere_mesh
from contenders import BANDS, REFERENCE_BANDS

BATCHES = 16
OURS: dict[str, Callable[..., RenderedImage]] = {
    "final gather": render_final_gather,
    "path tracer": render_path_tracer,
    "general path tracer": render_general_path_tracer,
}


def with_balls() -> Scene:
    """A ball on each block, which stock renders as a sphere, too."""
    box = cornell_box()
    positions = {"ball": (186.0, 215.0, 169.0), "second ball": (368.0, 380.0, 351.0)}
    balls = [Surface(name, "white", *sphere_mesh(at, 50.0), ball=True) for name, at in positions.items()]
    return replace(box, surfaces=(*box.surfaces, *balls))


def with_fine_ball() -> Scene:
    """A ball of very many triangles in place of the short block."""
    box = cornell_box()
    mesh = trimesh.creation.uv_sphere(80.0, (224, 224))
    vertices = np.asarray(mesh.vertices) + np.array([186.0, 82.5, 169.0])
    ball = Surface("ball", "white", vertices, np.asarray(mesh.faces, np.int64))
    return replace(box, surfaces=(*(s for s in box.surfaces if s.name != "short-block"), ball))


def glossy() -> Scene:
    box = cornell_box()
    coat = {"type": "roughplastic", "alpha": 0.2, "int_ior": 1.5, "diffuse_reflectance": "reflectance"}
    return replace(box, materials={**box.materials, "white": replace(box.materials["white"], bsdf=coat)})


def in_haze() -> Scene:
    slope = Spectrum(np.array([400.0, 700.0]), np.array([1e-3, 3e-4]))
    return replace(cornell_box(), medium=Medium(slope, slope.scaled(0.3), 0.4))


BOXES = {
    "published": cornell_box,
    "balls": with_balls,
    "99,904 triangles": with_fine_ball,
    "glossy": glossy,
    "haze": in_haze,
}


def means(first: RenderedImage, other: RenderedImage) -> list[np.ndarray]:
    """(batch, surface, w) of each, over the pixels that see one surface alone in both."""
    values = [image.coefficients @ image.spectra for image in (first, other)]
    visible = [_alone(first, index) & _alone(other, index) for index in range(len(first.surface_names))]
    return [np.stack([v[:, mask].mean(axis=1) for mask in visible if mask.any()], axis=1) for v in values]


def _alone(image: RenderedImage, index: int) -> np.ndarray:
    """(y, x) whether a surface, of any number of faces, covers all of a pixel."""
    return image.coverage[..., image.facet_surface == index].sum(axis=-1) > 1 - 1e-6


def compared(ours: np.ndarray, stock: np.ndarray) -> dict[str, Any]:
    """Of means (batch, surface, w)."""
    variance = (ours.var(axis=0, ddof=1) + stock.var(axis=0, ddof=1)) / BATCHES
    truth = stock.mean(axis=0)
    relative, error = (ours.mean(axis=0) - truth) / truth, np.sqrt(variance) / truth
    worst = np.unravel_index(np.argmax(np.abs(relative)), relative.shape)
    z = relative / error
    return {
        "rms": np.sqrt(np.mean(z**2)),
        "largest": np.abs(z).max(),
        "count": z.size,
        "difference": abs(relative[worst]),
        "its error": error[worst],
        "median error": np.median(error),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=32)
    parser.add_argument("--samples", type=int, default=512)
    options = parser.parse_args()
    camera, bands = cornell_camera(options.size), BANDS[REFERENCE_BANDS]
    for name, build in BOXES.items():
        scene = build()
        stock = render_stock(RenderJob(scene, camera, bands, options.samples, BATCHES, seed=1), variant="llvm_ad_rgb")
        for way, render in OURS.items():
            if way != "general path tracer" and not scene.diffuse:
                continue
            rates = compared(*means(render(RenderJob(scene, camera, bands, options.samples, BATCHES, seed=2)), stock))
            print(
                f"{name:18} {way:20} rms {rates['rms']:.2f}, largest {rates['largest']:.2f} of {rates['count']}; "
                f"{rates['difference']:.3%} +- {rates['its error']:.3%}, median error {rates['median error']:.3%}",
                flush=True,
            )


if __name__ == "__main__":
    main()
