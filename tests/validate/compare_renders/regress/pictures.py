"""Pictures of the published box with noise made up, so that thousands of pairs cost no rendering."""

import pickle
from dataclasses import fields, replace
from functools import cache

import numpy as np
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import render_image
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validation.compare_renders.regress import Side, SurfaceIndices
from cboxlab.validation.compare_renders.regress.variants import Variants, build_variants

SIZE = 48
WAVELENGTHS = np.arange(420.0, 701.0, 40.0)


@cache
def rendered(max_bounces=None):
    """(y, x, w) radiance with little noise, and the surface map."""
    image = render_image(
        RenderJob(
            cornell_box(), cornell_camera(SIZE), WAVELENGTHS, samples=64, batches=2, seed=5, max_bounces=max_bounces
        )
    )
    mean, _ = image.project(np.eye(WAVELENGTHS.size))
    surface = image.surface.astype(int)
    return mean, SurfaceIndices(surface, image.surface_names, surface == -1)


class RememberedVariants(Variants):
    """Variants that render each other scene once: many tests ask for the same ones."""

    def rebuilt(self, scene):
        return _rebuilt(pickle.dumps((scene, self.camera, self.side)))


@cache
def _rebuilt(pickled):
    """Variants of a scene, pickled since bytes compare by value."""
    return build_variants(*pickle.loads(pickled))


def remembered_variants(camera, side):
    """The program's own light of the published box, from which changes of transport are computed."""
    built = build_variants(cornell_box(), camera, side)
    return RememberedVariants(**{field.name: getattr(built, field.name) for field in fields(built)})


@cache
def variants():
    """Variants for the pictures of this module."""
    return remembered_variants(cornell_camera(SIZE), noisy(1))


def noisy(seed, picture=None, noise=0.04, batches=4, tails=0.0, fireflies=0.0, with_errors=True, mapped=True):
    """One side: a picture with skewed noise, nearly the same at all wavelengths, in a few batches.

    noise : relative, of a pixel. tails : part of the samples that are eight times as noisy. fireflies : part of the
    pixels with a Cauchy distributed excess of the mean radiance's scale.
    """
    rng = np.random.default_rng(seed)
    clean, surfaces = rendered()
    clean = clean if picture is None else picture
    shape = (batches, *clean.shape[:2])
    common = (rng.standard_gamma(1.0, shape) - 1) * np.where(rng.random(shape) < tails, 8.0, 1.0)
    batch_noise = 0.15 * rng.standard_normal((*shape, clean.shape[2]))
    values = clean * (1 + noise * np.sqrt(batches) * (common[..., None] + batch_noise))
    hit = rng.random(clean.shape[:2]) < fireflies
    values = values + np.where(hit, np.abs(rng.standard_cauchy(hit.shape)), 0.0)[..., None] * clean.mean()
    mean = values.mean(axis=0).astype(np.float32).astype(float)
    variance = values.var(axis=0, ddof=1) / batches
    side = Side(f"picture {seed}", WAVELENGTHS, mean, variance, batches - 1.0, surfaces)
    if not with_errors:
        side = replace(side, variance=None, degrees=0.0)
    return side if mapped else replace(side, surfaces=None)
