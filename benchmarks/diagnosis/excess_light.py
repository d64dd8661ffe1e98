"""Causes in lamp, paints, filters and surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.rendering.synthetic import unit_factors
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from excess_laboratory import (
    Draw,
    Laboratory,
    Made,
    Stack,
    Truth,
    of_other_scene,
    per_rate,
    scaled_change,
)
from scipy.ndimage import gaussian_filter1d


def _cube(lab: Laboratory) -> Stack:
    """(y, x, w) spectral radiance of the render."""
    mean, _ = lab.image.project(np.eye(len(WAVELENGTH_NM)))
    return np.asarray(mean)


def _responses(lab: Laboratory) -> tuple[Stack, Stack]:
    """(band, w) transmittances of the filters, and the responses of the rest."""
    factors = unit_factors(lab.settings, lab.camera.width_px)
    inside = [int(np.argmin(np.abs(factors.grid.nm - nm))) for nm in WAVELENGTH_NM]
    return factors.transmittance[:, inside], factors.rest[:, inside] * factors.factor[:, None]


def hotter_lamp(draw: Draw, lab: Laboratory) -> Made:
    """The lamp burns hotter or colder than when its table was measured, at the same power."""
    kelvin = 3000 + draw.choice([-1, 1]) * draw.uniform(10, 60)
    factor = np.exp(-1.4388e7 / WAVELENGTH_NM * (1 / kelvin - 1 / 3000))
    transmittance, rest = _responses(lab)
    weights = (transmittance * rest).T
    cube = _cube(lab)
    return Truth("lamp-spectrum"), per_rate(lab, lab.rate * _ratio(cube * factor @ weights, cube @ weights)), {}


def _ratio(new: Stack, old: Stack) -> Stack:
    return np.moveaxis(new / np.maximum(old, 1e-12), -1, 0)


def gas_lines(draw: Draw, lab: Laboratory) -> Made:
    """The lamp has lines of a gas that its table lacks."""
    lines = draw.uniform(410, 690, int(draw.integers(1, 4)))
    lamp = lab.scene.lamp.radiance.at(WAVELENGTH_NM)
    more = sum(draw.uniform(0.3, 1) * np.exp(-(((WAVELENGTH_NM - nm) / 3) ** 2)) for nm in lines)
    factor = 1 + draw.uniform(0.05, 0.4) * lamp.mean() * more / lamp
    transmittance, rest = _responses(lab)
    weights = (transmittance * rest).T
    cube = _cube(lab)
    return Truth("lamp-spectrum"), per_rate(lab, lab.rate * _ratio(cube * factor @ weights, cube @ weights)), {}


def uneven_lamp_by_colour(draw: Draw, lab: Laboratory) -> Made:
    """The lamp's cover scatters blue light wider than red: another lobe in each band."""
    t, bands = lab.data.transport, len(lab.rate)
    exponent = draw.uniform(0.05, 0.3) * (lab.data.nm - lab.data.nm.mean()) / np.ptp(lab.data.nm)
    lamp = lab.scene.lamp.surface.vertices_mm.mean(axis=0)

    def lobe(points: Stack) -> Stack:
        way = points - lamp
        cosine = np.clip(-way[:, 1] / np.maximum(np.linalg.norm(way, axis=1), 1), 0.02, 1)
        return cosine[:, None] ** exponent * (exponent + 2) / 2

    picture = np.zeros((bands, lab.shape[0] * lab.shape[1]))
    old = picture.copy()
    for band in range(bands):
        rho = t.reflectance[t.patch_material, band]
        for image, factors in ((picture, (lobe(t.position), lobe(t.patch_position))), (old, (1, 1))):
            fragment, patch = (f if np.isscalar(f) else f[:, band] for f in factors)
            radiosity = np.linalg.solve(
                np.eye(len(rho)) - rho[:, None] * t.form_factors, rho * t.patch_direct[:, band] * patch
            )
            arriving = t.direct[:, band] * fragment + t.gather @ radiosity
            image[band] = np.bincount(t.pixel, t.coverage * t.reflectance[t.material, band] * arriving, image.shape[1])
    ratio = np.where(old > 0, picture / np.maximum(old, 1e-12), 1.0).reshape(lab.rate.shape)
    return Truth("lamp-spectrum"), per_rate(lab, lab.rate * ratio), {}


def aged_paints(draw: Draw, lab: Laboratory) -> Made:
    """All paints yellowed: they reflect less blue, each otherwise."""
    scene = lab.scene
    for name in tuple(scene.materials):
        factor = 1 - draw.uniform(0.005, 0.05) * np.exp(-(((WAVELENGTH_NM - 400) / draw.uniform(40, 90)) ** 2))
        scene = _repainted(scene, name, factor)
    return Truth("paint-spectrum"), of_other_scene(lab, scene), {}


def other_batch(draw: Draw, lab: Laboratory) -> Made:
    """One wall or one block was painted with another batch: lighter, darker, or of another hue."""
    surface = lab.scene.surfaces[int(draw.integers(len(lab.scene.surfaces)))]
    old = lab.scene.materials[surface.material]
    x = (WAVELENGTH_NM - 550) / 150
    factor = 1 + draw.normal(0, 0.02) * np.tanh(2 * x) + draw.normal(0, 0.02) * np.exp(-((x / 0.3) ** 2))
    new = replace(
        old,
        name="batch",
        reflectance=Spectrum(WAVELENGTH_NM, np.clip(old.reflectance.at(WAVELENGTH_NM) * factor, 0, 1)),
    )
    surfaces = tuple(replace(s, material="batch") if s is surface else s for s in lab.scene.surfaces)
    scene = replace(lab.scene, surfaces=surfaces, materials={**lab.scene.materials, "batch": new})
    return Truth("paint-spectrum", None, surface.name), of_other_scene(lab, scene), {}


def _repainted(scene: Scene, material: str, factor: Stack) -> Scene:
    old = scene.materials[material]
    values = np.clip(old.reflectance.at(WAVELENGTH_NM) * factor, 0, 1)
    return replace(
        scene, materials={**scene.materials, material: replace(old, reflectance=Spectrum(WAVELENGTH_NM, values))}
    )


def _of_filters(lab: Laboratory, changed: Stack, in_references: bool) -> Stack:
    """Change by other transmittances (band, w); references and flats see the sphere through them too."""
    transmittance, rest = _responses(lab)
    cube = _cube(lab)
    ratio = _ratio(cube @ (changed * rest).T, cube @ (transmittance * rest).T)
    if in_references:
        sphere = 1e-5 * 1 / (WAVELENGTH_NM**5.0) / (np.exp(1.4388e7 / (WAVELENGTH_NM * 2856.0)) - 1)
        level = (changed * rest) @ sphere / ((transmittance * rest) @ sphere)
        ratio = ratio / level[:, None, None]
    return per_rate(lab, lab.rate * ratio)


def red_leak(draw: Draw, lab: Laboratory) -> Made:
    """One filter lets light through far from its band."""
    transmittance, _ = _responses(lab)
    band = int(draw.integers(len(transmittance)))
    peaks = WAVELENGTH_NM[np.argmax(transmittance, axis=1)]
    far = draw.choice(WAVELENGTH_NM[np.abs(WAVELENGTH_NM - peaks[band]) > 70])
    changed = transmittance.copy()
    changed[band] += draw.uniform(0.001, 0.012) * np.exp(-(((WAVELENGTH_NM - far) / draw.uniform(10, 40)) ** 2))
    return Truth("filter-curve"), _of_filters(lab, changed, bool(draw.random() < 0.6)), {}


def next_filters_light(draw: Draw, lab: Laboratory) -> Made:
    """The wheel stops early: a part of the light passes the next filter."""
    transmittance, _ = _responses(lab)
    band = int(draw.integers(len(transmittance)))
    other = (band + int(draw.choice([-1, 1]))) % len(transmittance)
    part, changed = draw.uniform(0.003, 0.03), transmittance.copy()
    changed[band] = (1 - part) * transmittance[band] + part * transmittance[other]
    return Truth("filter-curve"), _of_filters(lab, changed, bool(draw.random() < 0.5)), {}


def wrong_table(draw: Draw, lab: Laboratory) -> Made:
    """One filter's table is of another piece: its curve is shifted and wider."""
    transmittance, _ = _responses(lab)
    band, nm = int(draw.integers(len(transmittance))), WAVELENGTH_NM
    changed = transmittance.copy()
    changed[band] = np.interp(
        nm - draw.choice([-1, 1]) * draw.uniform(2, 8), nm, gaussian_filter1d(transmittance[band], draw.uniform(0.5, 3))
    )
    return Truth("filter-curve"), _of_filters(lab, changed, True), {}


def gradient(draw: Draw, lab: Laboratory) -> Made:
    """Paint rolled unevenly over one wall: smooth shades along it, with what they reflect further left out."""
    names = [n for n in lab.data.names if n not in ("short-block", "tall-block")]
    surface = lab.data.names.index(str(draw.choice(names)))
    t = lab.data.transport
    on = t.surface == surface
    low, extent = t.position[on].min(axis=0), np.maximum(np.ptp(t.position[on], axis=0), 1.0)
    x = (t.position - low) / extent
    shade = np.sin(
        draw.uniform(1.5, 4) * x[:, 0]
        + draw.uniform(1.5, 4) * x[:, 1]
        + draw.uniform(1.5, 4) * x[:, 2]
        + draw.uniform(0, 6)
    )
    map_ = np.bincount(t.pixel, t.coverage * on * shade, lab.shape[0] * lab.shape[1]).reshape(lab.shape)
    colour = 1 + draw.uniform(-0.5, 0.5) * (lab.data.nm - 550) / 150
    change = lab.data.signal * map_ * colour[:, None, None]
    return Truth("reflectance-map", None, lab.data.names[surface]), scaled_change(draw, lab, change, 0.12), {}


def shiny_plate(draw: Draw, lab: Laboratory) -> Made:
    """A thin clear plate lies on the floor: it mirrors the box behind it, traced from the picture itself."""
    t = lab.data.transport
    floor = lab.data.names.index("floor")
    centre = np.array([draw.uniform(300, 480), 0.0, draw.uniform(40, 180)])
    angle, half = draw.uniform(0, np.pi), draw.uniform(25, 60, 2)
    local = t.position - centre
    along = local[:, 0] * np.cos(angle) + local[:, 2] * np.sin(angle)
    across = -local[:, 0] * np.sin(angle) + local[:, 2] * np.cos(angle)
    on = (t.surface == floor) & (np.abs(along) < half[0]) & (np.abs(across) < half[1])
    eye = lab.camera.position_mm
    way = t.position - eye
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    cosine = np.abs(way[:, 1])
    mirrored = way * [1, -1, 1]
    values = np.zeros((len(t.pixel), len(lab.rate)))
    box = np.array([[0.0, 0, 0], [556, 548.8, 559.2]])
    for f in np.flatnonzero(on):
        limit = np.where(mirrored[f] > 0, box[1], box[0])
        distance = np.min(np.where(np.abs(mirrored[f]) > 1e-9, (limit - t.position[f]) / mirrored[f], np.inf))
        hit = t.position[f] + distance * mirrored[f]
        u, v = lab.camera.project(hit[None])[0]
        if 0 <= u < lab.shape[1] - 1 and 0 <= v < lab.shape[0] - 1:
            values[f] = lab.rate[:, round(v), round(u)]
    n = 1.5
    inner = np.sqrt(1 - (1 - cosine**2) / n**2)
    fresnel = 0.5 * (
        ((cosine - n * inner) / (cosine + n * inner)) ** 2 + ((inner - n * cosine) / (inner + n * cosine)) ** 2
    )
    both = 2 * fresnel / (1 + fresnel)
    change = []
    for band in range(len(lab.rate)):
        lamp_rate = lab.rate[band].ravel()[t.pixel]
        change.append(
            np.bincount(t.pixel, t.coverage * on * both * (values[:, band] - lamp_rate), lab.shape[0] * lab.shape[1])
        )
    picture = np.reshape(change, lab.rate.shape)
    image_px = lab.camera.project(centre[None])[0]
    truth = Truth("reflection-lobe", (float(image_px[0]), float(image_px[1])), "floor")
    return truth, per_rate(lab, lab.rate + picture), {}


def velvet(draw: Draw, lab: Laboratory) -> Made:
    """Dusty white paint: fibres brighten it at grazing view, and it is darker where light comes steeply."""
    t = lab.data.transport
    white = t.material == lab.data.materials.index("white")
    lobe = draw.uniform(0.02, 0.15) * (1 - t.view) ** 3 - draw.uniform(0, 0.08) * (1 - t.incidence) ** 2
    map_ = np.bincount(t.pixel, t.coverage * white * lobe, lab.shape[0] * lab.shape[1]).reshape(lab.shape)
    return Truth("reflection-lobe"), scaled_change(draw, lab, lab.data.signal * map_, 2.0), {}


def window(draw: Draw, lab: Laboratory) -> Made:
    """Daylight from the room falls through the opening: brighter towards the front, bluish."""
    t = lab.data.transport
    source = np.array([draw.uniform(0, 556), draw.uniform(100, 549), -draw.uniform(300, 900)])
    way = source - t.position
    distance = np.linalg.norm(way, axis=1)
    normals = np.zeros((len(t.pixel), 3))
    for index, name in enumerate(lab.data.names):
        axis = {"floor": (0, 1, 0), "ceiling": (0, -1, 0), "back": (0, 0, -1), "right": (1, 0, 0), "left": (-1, 0, 0)}
        normals[t.surface == index] = axis.get(name, (0, 0.5, -0.8))
    light = np.clip(np.sum(way / distance[:, None] * normals, axis=1), 0, 1) / (distance / 500) ** 2
    spectrum = (lab.data.nm / 550) ** -3
    change = []
    for band in range(len(lab.rate)):
        bounced = t.gather @ (t.reflectance[t.patch_material, band] * 0.15)
        value = t.reflectance[t.material, band] * (light + bounced) * spectrum[band]
        change.append(np.bincount(t.pixel, t.coverage * value, lab.shape[0] * lab.shape[1]))
    picture = np.reshape(change, lab.rate.shape) * lab.data.exposure_s[:, None, None]
    return Truth("extra-light"), scaled_change(draw, lab, picture / picture.mean() * lab.data.signal.mean()), {}
