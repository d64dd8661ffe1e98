"""Spoilt pictures of the published box of kinds that no list had: answer, probability, and whether it fits.

    python regress_unlisted.py [--kinds "depth of field,motion blur"]

Each kind was made up after the names were finished. Where a name describes it truly, it stands next to the kind; for
most only `unknown` is right. Noise, scene and verdict are those of `regress_spoilt.py`, at 48 x 48 pixels. About ten
minutes of one core.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import regress_spoilt as made
from cboxlab.scenes import Spectrum, cornell_box, cornell_camera
from cboxlab.validation.compare_renders.regress import UNKNOWN, View, regress_pictures
from cboxlab.validation.compare_renders.regress.variants import Variants, build_variants
from numpy.typing import NDArray
from regress_spoilt import WAVELENGTHS, axes, clean, noisy, order, surfaces, traced
from scipy.ndimage import gaussian_filter, map_coordinates, uniform_filter1d, zoom

made.SIZE, made.SAMPLES = 48, 256
SIZE = made.SIZE
Picture = NDArray[np.float64]


def per_pixel(of: Callable[[Variants], Picture]) -> Picture:
    """(y, x, 1) a quantity of the surface seen, averaged over a pixel's surfaces."""
    variants = build_variants(cornell_box(), cornell_camera(SIZE), surfaces())
    values = variants.light.transport.pixels(np.stack([of(variants), np.ones_like(of(variants))], axis=1))
    # 1 where no surface is seen
    return np.where(values[1] > 1e-6, values[0] / np.maximum(values[1], 1e-6), 1.0)[..., None]


def towards_camera(variants: Variants) -> Picture:
    transport = variants.light.transport
    away = cornell_camera(SIZE).position_mm - transport.position
    return np.abs((away * transport.normal).sum(axis=1)) / np.linalg.norm(away, axis=1)


def towards_lamp(variants: Variants) -> Picture:
    transport = variants.light.transport
    away = variants.scene.lamp.surface.vertices_mm.mean(axis=0) - transport.position
    return np.maximum(np.abs((away * transport.normal).sum(axis=1)) / np.linalg.norm(away, axis=1), 0.2)


def distance(variants: Variants) -> Picture:
    return np.linalg.norm(cornell_camera(SIZE).position_mm - variants.light.transport.position, axis=1) / 1000.0


def lamp_black(picture: Picture) -> Picture:
    """Picture with the clean lamp."""
    visible = surfaces().surfaces
    assert visible is not None
    return np.where(np.asarray(visible.lamp)[..., None], clean(), picture)


def without(name: str) -> Picture:
    box_ = cornell_box()
    return traced(replace(box_, surfaces=tuple(s for s in box_.surfaces if s.name != name)))


def own_paint(surface: str, of: Callable[[Spectrum], Spectrum]) -> Picture:
    """Box with another reflectance on one surface alone."""
    box_ = cornell_box()
    material = next(s.material for s in box_.surfaces if s.name == surface)
    paint = replace(box_.materials[material], name="other")
    paint = replace(paint, reflectance=of(paint.reflectance))
    changed = tuple(replace(s, material="other") if s.name == surface else s for s in box_.surfaces)
    return traced(replace(box_, surfaces=changed, materials={**box_.materials, "other": paint}))


def squared(spectrum: Spectrum) -> Spectrum:
    return replace(spectrum, values=np.asarray(spectrum.values) ** 2)


def with_band(picture: Picture, band: int, values: Picture) -> Picture:
    changed = picture.copy()
    changed[..., band] = values
    return changed


def moved_outwards(picture: Picture, by: float) -> Picture:
    y, x = np.indices(picture.shape, float)
    middle = (SIZE - 1) / 2
    return map_coordinates(picture, [middle + (y - middle) / by, middle + (x - middle) / by], order=1, mode="nearest")


def chromatic(part: float) -> Picture:
    planes = [moved_outwards(clean()[..., n], 1 + part * (n - 3.5) / 3.5) for n in range(WAVELENGTHS.size)]
    return np.stack(planes, axis=-1)


def in_rows(picture: Picture, by: int) -> Picture:
    changed = picture.copy()
    changed[1::2] = np.roll(picture[1::2], by, axis=1)
    return changed


def with_patch(picture: Picture, rows: slice, columns: slice, values: Picture | float) -> Picture:
    changed = picture.copy()
    changed[rows, columns] = values
    return changed


def out_of_focus(strength: float) -> Picture:
    off = strength * np.abs(per_pixel(distance) - 1.1)
    levels = [clean(), *(gaussian_filter(clean(), (s, s, 0)) for s in (0.5, 1.0, 1.5, 2.0))]
    index = np.clip(2 * off, 0, 3.999)
    low = index.astype(int)[..., 0]
    part = index - low[..., None]
    stacked = np.stack(levels)
    y, x = np.indices(low.shape)
    return (1 - part) * stacked[low, y, x] + part * stacked[low + 1, y, x]


def occluded_ambient(ambient: float) -> Picture:
    return clean(1) + ambient * order(2).mean(axis=(0, 1)) * occlusion()


def occlusion() -> Picture:
    """Openness, from the light after two reflections alone."""
    total = order(2).sum(axis=-1, keepdims=True)
    return np.clip(gaussian_filter(total / max(float(total.mean()), 1e-300), (2, 2, 0)), 0, 2)


def later(weight: Callable[[int], float]) -> Picture:
    total = clean(1).copy()
    for n in range(2, 7):
        total += weight(n) * order(n)
    return total + weight(7) * (clean() - clean(6))


def seams(part: float) -> Picture:
    edge = (np.arange(SIZE) % 16 == 0) & (np.arange(SIZE) > 0)
    return clean() * (1 + part * (edge[:, None] | edge[None]))[..., None]


def saturated(colour: float) -> Picture:
    indirect = clean() - clean(1)
    grey = indirect.mean(axis=-1, keepdims=True) * clean(1).mean(axis=(0, 1)) / clean(1).mean()
    return clean(1) + (1 - colour) * indirect + colour * grey


#: By kind: names that are true besides `unknown`, and the picture.
KINDS: dict[str, tuple[set[str], Callable[[], Picture]]] = {
    "one band to a power": (set(), lambda: with_band(clean(), 2, clean()[..., 2] ** 1.15)),
    "two bands exchanged": ({"bands-exchanged"}, lambda: clean()[..., [0, 5, 2, 3, 4, 1, 6, 7]]),
    "lamp spectrum rounded": ({"lamp-spectrum"}, lambda: clean() * np.array([1.0, 0.97, 1.02, 1, 0.99, 1.03, 0.98, 1])),
    "bands leak into neighbours": (
        set(),
        lambda: 0.9 * clean() + 0.05 * (np.roll(clean(), 1, -1) + np.roll(clean(), -1, -1)),
    ),
    "albedo of a block squared": ({"paint"}, lambda: own_paint("tall-block", squared)),
    "albedo of the floor squared": ({"paint"}, lambda: own_paint("floor", squared)),
    "ambient occlusion for reflections": (set(), lambda: occluded_ambient(1.3)),
    "roulette paid back twice": (set(), lambda: later(lambda n: 1.0 if n < 4 else 1.25 ** (n - 3))),
    "odd reflections alone too bright": (set(), lambda: later(lambda n: 1.2 if n % 2 else 1.0)),
    "no cosine at the surface": (set(), lambda: clean() + 0.5 * order(1) * (1 / per_pixel(towards_lamp) - 1)),
    "cosine squared": (set(), lambda: clean() + order(1) * (per_pixel(towards_lamp) - 1) * 0.5),
    "dark at grazing angles": (set(), lambda: lamp_black(clean() * (1 - 0.5 * (1 - per_pixel(towards_camera)) ** 5))),
    "flash at the camera": (
        set(),
        lambda: lamp_black(clean() + 0.1 * clean().mean() * per_pixel(towards_camera) / per_pixel(distance) ** 2),
    ),
    "negative lobes": ({"pixel-filter"}, lambda: 1.3 * clean() - 0.3 * gaussian_filter(clean(), (1, 1, 0))),
    "tone mapping x / (1 + x)": (set(), lambda: clean() / (1 + 0.3 * clean() / clean().mean())),
    "response less a square": (set(), lambda: clean() - 0.03 * clean() ** 2 / np.percentile(clean(), 90)),
    "shadows lifted": (set(), lambda: clean() + 0.03 * clean().mean() * np.exp(-clean() / (0.5 * clean().mean()))),
    "NaN in one band is 0": ({"pattern"}, lambda: with_patch(clean(), slice(30, 33), slice(20, 40, 5), 0.0)),
    "seams between tiles": ({"pattern"}, lambda: seams(0.06)),
    "reflections at half size": (set(), lambda: clean(1) + np.kron((clean() - clean(1))[::4, ::4], np.ones((4, 4, 1)))),
    "direct light smoothed": (set(), lambda: lamp_black(clean() - order(1) + gaussian_filter(order(1), (2, 2, 0)))),
    "colour of reflections lost": (set(), lambda: saturated(0.5)),
    "haze by distance": (
        set(),
        lambda: clean() * np.exp(-0.08 * per_pixel(distance)) + 0.03 * clean().mean() * per_pixel(distance),
    ),
    "flare": (
        set(),
        lambda: clean() + 0.1 * clean().mean() * np.exp(-((axes()[0] - 0.3) ** 2 + (axes()[1] + 0.2) ** 2) / 0.02),
    ),
    "veiling glare": (set(), lambda: 0.95 * clean() + 0.05 * gaussian_filter(clean(), (8, 8, 0))),
    "chromatic aberration": (set(), lambda: chromatic(0.02)),
    "odd rows moved by a pixel": ({"pattern"}, lambda: in_rows(clean(), 1)),
    "block missing": ({"missing-geometry"}, lambda: without("short-block")),
    "local contrast": (set(), lambda: clean() * (gaussian_filter(clean(), (6, 6, 0)) / clean().mean()) ** -0.1),
    "last rows of an earlier frame": (
        {"border", "pattern"},
        lambda: with_patch(clean(), slice(44, 48), slice(0, SIZE), 0.92 * clean()[44:]),
    ),
    "one tile shows its neighbour": (
        {"pattern"},
        lambda: with_patch(clean(), slice(32, 40), slice(8, 16), clean()[32:40, 16:24]),
    ),
    "depth of field": (set(), lambda: out_of_focus(1.5)),
    "motion blur": (set(), lambda: uniform_filter1d(clean(), 3, axis=1)),
    "left half of a darker lamp": (set(), lambda: clean() * np.where(axes()[1] < 0, 0.97, 1.0)),
    "light after three reflections blue": (
        set(),
        lambda: clean() + order(3) * np.linspace(0.6, -0.2, WAVELENGTHS.size),
    ),
    "enlarged from half size": (
        set(),
        lambda: zoom(clean().reshape(24, 2, 24, 2, -1).mean(axis=(1, 3)), (2, 2, 1), order=1),
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default="", help="Joined by commas; all where left out.")
    options = parser.parse_args()
    kinds = {name: KINDS[name] for name in options.kinds.split(",")} if options.kinds else KINDS
    view = View(cornell_box(), cornell_camera(SIZE), True)
    counts = dict.fromkeys(("right", "unknown", "wrong", "same", "wrong above 0.9"), 0)
    start = time.process_time()
    for number, (kind, (names, picture)) in enumerate(kinds.items()):
        outcome = regress_pictures(noisy(clean(), 7000 + 2 * number), noisy(picture(), 7001 + 2 * number), view)
        first = outcome.changes[0] if outcome.changes else None
        if outcome.same or first is None:
            verdict = "same"
        elif "pattern" in names and outcome.cancelling:
            verdict = "right"
        elif first.change == UNKNOWN or not first.fits:
            verdict = "unknown" if names else "right"
        else:
            verdict = "right" if first.change in names else "wrong"
        counts[verdict] += 1
        best = outcome.best_name
        high = best is not None and best.change not in names and best.probability > 0.9
        counts["wrong above 0.9"] += high and verdict != "same"
        said = "" if best is None else f"{best.change} {best.probability:.2f} {'fits' if best.fits else 'does not fit'}"
        also = f"; {outcome.cancelling}" if outcome.cancelling else ""
        print(f"{kind:34s} {verdict:8s} {'' if first is None else first.change:16s} {said}{also}", flush=True)
    print(", ".join(f"{name} {count}" for name, count in counts.items()), f"of {len(kinds)}")
    print(f"{time.process_time() - start:.0f} CPU seconds")


if __name__ == "__main__":
    main()
