"""Explanations by the scene: path depth, paints, walls, lamp's size, gloss, ambient cache."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from cboxlab.rendering.effects import apply_checked, names_in
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from .evidence import Evidence, Fit
from .explanations import FittedChange, group_name
from .variants import Variants, with_lamp_size

__all__ = ["coats", "from_scene", "smooth_over_surfaces"]

#: Numbers of reflections after which paths may end: later ones carry too little light of the box.
_DEPTHS = range(1, 13)
#: Survival probabilities of a roulette whose loss is not compensated.
_SURVIVALS = (0.5, 0.7, 0.8, 0.9, 0.95, 0.98)
#: Reflections that such a roulette may spare.
_SPARED = range(5)
#: Relative step of a reflectance in finite differences.
_PAINT_STEP = 0.02
#: Relative step of the lamp's edges in finite differences.
_LAMP_STEP = 0.1
#: Largest relative change of the lamp's edges to which first order applies.
_MAX_LAMP_CHANGE = 0.5
#: Largest reflectance of a paint.
_MAX_REFLECTANCE = 0.98
#: Smallest factor on a paint.
_MIN_PAINT_FACTOR = 0.05
#: Widths of interpolation between records of an ambient cache, over the picture's width.
_CACHE_WIDTHS = (0.03, 0.06, 0.12)
#: Roughnesses of a coat: polished, satin, rough.
_ROUGHNESSES = (0.05, 0.15, 0.35)
#: Ratio of a rendering with a larger or smaller lamp to the unchanged one, above which a pixel shows the lamp.
_LAMP_RATIO = 5
#: Fewest wavelengths for which shifts of wavelengths are fitted.
_MIN_WAVELENGTHS = 4


def from_scene(evidence: Evidence, variants: Variants) -> Iterator[FittedChange]:
    """Fitted explanations by the scene, without gloss.

    Parameters
    ----------
    evidence
        Numbers that a change has to explain.
    variants
        Rendering of the scene.

    Yields
    ------
    FittedChange
        Path depth, paints, swapped walls, ambient cache, lamp's size, wavelengths.
    """
    depths = [variants.light.change(max_bounces=k).picture() for k in _DEPTHS]
    yield from _depth(evidence, variants, depths)
    yield from _paints(evidence, variants)
    yield from _swapped(evidence, variants)
    yield from _cache(evidence, variants, depths[0])
    yield from _lamp_size(evidence, variants)
    yield from _wavelengths(evidence, variants)


def _change(evidence: Evidence, variants: Variants, picture: NDArray) -> NDArray[np.float64]:
    """(y, x, w) change of the baseline where the scene's rendering becomes ``picture``."""
    return evidence.baseline * (variants.ratio(picture) - 1)


def _depth(evidence: Evidence, variants: Variants, depths: list[NDArray]) -> Iterator[FittedChange]:
    """Paths that end after some reflections, or by a roulette whose loss is not compensated."""
    for number, picture in zip(_DEPTHS, depths, strict=True):
        fit = evidence.fit([], _change(evidence, variants, picture))
        yield FittedChange("path-depth", {"max_bounces": number}, fit, 1)
    orders = [b - a for a, b in zip(depths, [*depths[1:], variants.picture], strict=True)]
    for spared in _SPARED:
        for survival in _SURVIVALS:
            remaining = depths[0] * (survival if spared == 0 else 1.0)
            for reflections, light in enumerate(orders, start=2):
                remaining = remaining + light * survival ** max(reflections - spared, 0)
            picture = np.where(variants.light.seen_lamps > 0, variants.picture, remaining)
            fit = evidence.fit([], _change(evidence, variants, picture))
            yield FittedChange("path-depth", {"max_bounces": spared, "survival_not_made_up_for": survival}, fit, 2)


def _paints(evidence: Evidence, variants: Variants) -> Iterator[FittedChange]:
    """Reflectance of a material or a surface times a factor, or times one for each group."""
    light, transport = variants.light, variants.light.transport
    materials, surfaces = list(variants.scene.materials), [s.name for s in variants.scene.surfaces]
    choices = [
        ("material", n, i, transport.light.patches.material, transport.material) for i, n in enumerate(materials)
    ]
    choices += [("surface", n, i, variants.patch_surface, transport.surface) for i, n in enumerate(surfaces)]
    walls = {name: [s.name for s in variants.scene.surfaces if s.material == name] for name in materials}
    for kind, name, number, of_patch, of_fragment in choices:
        if kind == "surface" and len(walls[variants.scene.surfaces[number].material]) == 1:
            continue

        def picture(factor: float, n: int = number, p: NDArray = of_patch, f: NDArray = of_fragment) -> NDArray:
            by_patch, by_fragment = (np.where(index == n, factor, 1.0)[:, None] for index in (p, f))
            return variants.with_paints(light.patch_reflectance * by_patch, light.fragment_reflectance * by_fragment)

        most = _MAX_REFLECTANCE / float(light.patch_reflectance[of_patch == number].max())
        if most <= 1 + _PAINT_STEP:
            continue
        step = _change(evidence, variants, picture(1 + _PAINT_STEP)) / _PAINT_STEP
        fit = evidence.fit([step])
        factor = float(np.clip(1 + fit.amplitudes[0], _MIN_PAINT_FACTOR, most))
        best = fit
        if abs(factor - 1) > 2 * _PAINT_STEP:
            for _ in range(2):
                now = _change(evidence, variants, picture(factor))
                fit = evidence.fit([step], now)
                best = min(best, evidence.fit([], now), key=lambda f: f.chi2)
                factor = float(np.clip(factor + fit.amplitudes[0], _MIN_PAINT_FACTOR, most))
        yield FittedChange("paint", {kind: name, "factor": factor}, best, 1)
        if kind == "material" and evidence.groups > 1:
            masks = [evidence.group == g for g in range(evidence.groups)]
            fit = evidence.fit([step * mask for mask in masks])
            factors = {group_name(variants.side, m): 1 + float(a) for m, a in zip(masks, fit.amplitudes, strict=True)}
            yield FittedChange("paint", {kind: name, "factor_by_nm": factors}, fit, len(masks))


def _swapped(evidence: Evidence, variants: Variants) -> Iterator[FittedChange]:
    """Paints of two surfaces of different materials exchanged."""
    scene, light = variants.scene, variants.light
    table = np.array([m.reflectance.at(variants.coarse_nm) for m in scene.materials.values()])
    number = {name: i for i, name in enumerate(scene.materials)}
    for (i, a), (j, b) in combinations(enumerate(scene.surfaces), 2):
        if a.material == b.material:
            continue
        patches, fragments = light.patch_reflectance.copy(), light.fragment_reflectance.copy()
        for index, material in ((i, b.material), (j, a.material)):
            patches[variants.patch_surface == index] = table[number[material]]
            fragments[light.transport.surface == index] = table[number[material]]
        change = _change(evidence, variants, variants.with_paints(patches, fragments))
        yield FittedChange("swapped-walls", {"surfaces": [a.name, b.name]}, evidence.fit([], change), 1)


def _cache(evidence: Evidence, variants: Variants, direct: NDArray) -> Iterator[FittedChange]:
    """Light reflected more than once smoothed over each surface, and times a factor."""
    surfaces = variants.surface_map().index
    indirect = np.maximum(variants.picture - direct, 0)
    doubled = evidence.baseline * (variants.ratio(variants.picture + indirect) - 1)
    for width in _CACHE_WIDTHS:
        smooth = np.zeros_like(indirect)
        for index in np.unique(surfaces[surfaces >= 0]):
            mask = surfaces == index
            sigma = width * mask.shape[1]
            share = np.maximum(gaussian_filter(mask.astype(float), sigma), 1e-9)
            for band, picture in enumerate(indirect):
                smooth[band] += np.where(mask, gaussian_filter(picture * mask, sigma) / share, 0.0)
        change = np.where(surfaces >= 0, smooth - indirect, 0.0)
        template = _change(evidence, variants, variants.picture + change)
        fit = evidence.fit([template, doubled])
        smoothed, factor = float(fit.amplitudes[0]), 1 + float(fit.amplitudes[1])
        parameters = {"width_of_picture": width, "smoothed": smoothed, "indirect_factor": factor}
        yield FittedChange("ambient-cache", parameters, fit, 3)


def smooth_over_surfaces(evidence: Evidence, variants: Variants) -> tuple[Fit, int]:
    """Fit of changes of indirect light that are smooth over each surface, whatever their cause.

    Second-order polynomials of the picture's coordinates, one on each surface, fit many changes. They describe a change
    that has no name, and name none.

    Parameters
    ----------
    evidence
        Numbers that a change has to explain.
    variants
        Rendering of the scene.

    Returns
    -------
    fit
        The fit.
    free
        Number of free amplitudes, six for each surface.
    """
    surfaces = variants.surface_map().index
    indirect = np.maximum(variants.picture - variants.light.change(max_bounces=1).picture(), 0)
    change = evidence.baseline * (variants.ratio(variants.picture + indirect) - 1)
    rows, columns = (np.linspace(-1, 1, size) for size in surfaces.shape)
    y, x = np.meshgrid(rows, columns, indexing="ij")
    shapes = [np.ones_like(x), x, y, x * x, x * y, y * y]
    templates = [
        change * ((surfaces == index) * shape)[..., None]
        for index in np.unique(surfaces[surfaces >= 0])
        for shape in shapes
    ]
    return evidence.fit(templates), len(templates)


def _lamp_size(evidence: Evidence, variants: Variants) -> Iterator[FittedChange]:
    """Larger or smaller edges of the lamp, with its radiance, to first order."""
    grown, smaller = (variants.rebuilt(with_lamp_size(variants.scene, 1 + step)) for step in (_LAMP_STEP, -_LAMP_STEP))
    fitted = []
    for picture, step in ((grown.picture, _LAMP_STEP), (smaller.picture, -_LAMP_STEP)):
        change = np.clip(variants.ratio(picture) - 1, -1, _LAMP_RATIO) * evidence.baseline
        lamp = evidence.baseline.sum(axis=-1) * (variants.ratio(picture).mean(axis=-1) > _LAMP_RATIO)
        change = np.where((lamp > 0)[..., None], 0.0, change) / step
        fit = evidence.fit([change, evidence.baseline])
        parameters = {
            "edge_factor": 1 + float(fit.amplitudes[0]),
            "radiance_factor": 1 + float(fit.amplitudes[1]),
        }
        if abs(fit.amplitudes[0]) <= _MAX_LAMP_CHANGE and parameters["radiance_factor"] > 0:
            fitted.append(FittedChange("lamp-size", parameters, fit, 2))
    yield from sorted(fitted, key=lambda e: e.chi2)[:1]


def _wavelengths(evidence: Evidence, variants: Variants) -> Iterator[FittedChange]:
    """Edges of wavelength bins taken for their centres: half a step off, or stretched by a step.

    Paints are those of the scene. The lamp's spectrum is that of the baseline, linear between wavelengths.
    """
    at = variants.side.wavelength_nm
    if at.size < _MIN_WAVELENGTHS or variants.side.in_colour:
        return
    half = float(np.median(np.diff(at))) / 2
    unmoved = variants.at(at)
    total = evidence.baseline.reshape(-1, at.size).sum(axis=0)
    lamp = total / np.maximum(unmoved.reshape(-1, at.size).sum(axis=0), 1e-300)
    across = np.linspace(-1, 1, at.size)
    for name, off in {"shift_nm": half * np.ones(at.size), "stretch_nm": half * across}.items():
        for sign in (1.0, -1.0):
            moved = at + sign * off
            slope = np.interp(moved, (at[1:] + at[:-1]) / 2, np.diff(lamp) / np.diff(at))
            light = np.maximum(np.interp(moved, at, lamp) + slope * (moved - np.clip(moved, at[0], at[-1])), 0)
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = np.where(unmoved * lamp > 0, variants.at(moved) * light / (unmoved * lamp), 1.0)
            fit = evidence.fit([], evidence.baseline * (ratio - 1))
            yield FittedChange("wavelengths", {name: sign * half}, fit, 1)


def coats(evidence: Evidence, variants: Variants) -> Iterator[FittedChange]:
    """Fitted explanations by a specular coat on one material.

    Strength and factor on the diffuse part are fitted together: glossy models (rough plastic, principled) change the
    diffuse part too.

    Parameters
    ----------
    evidence
        Numbers that a change has to explain.
    variants
        Rendering of the scene.

    Yields
    ------
    FittedChange
        One for each material and roughness whose strength is positive.
    """
    names, light = names_in(variants.scene), variants.light
    for number, material in enumerate(variants.scene.materials):
        fewer = 1 - _PAINT_STEP
        patches, fragments = (
            np.where(index == number, fewer, 1.0)[:, None]
            for index in (light.transport.light.patches.material, light.transport.material)
        )
        darker = variants.with_paints(light.patch_reflectance * patches, light.fragment_reflectance * fragments)
        diffuse = -_change(evidence, variants, darker) / _PAINT_STEP
        for roughness in _ROUGHNESSES:
            values: dict[str, str | float] = {"material": material, "specular": 1.0, "roughness": roughness}
            try:
                applied = apply_checked("gloss", values, "gloss", names)
            except InputError:
                return
            change = _change(evidence, variants, applied.apply(variants.light).picture())
            fit = evidence.fit([change, diffuse])
            specular, factor = float(fit.amplitudes[0]), 1 + float(fit.amplitudes[1])
            parameters = {
                "material": material,
                "roughness": roughness,
                "specular": specular,
                "diffuse_factor": factor,
            }
            if specular > 0:
                yield FittedChange("gloss", parameters, fit, 3)
