"""Causes that no catalogue holds, made by code that shares no formula with the families of ``validate.explain``.

Things and stains are meshes in the rendered scene, another lamp is another picture, paints and lamps are other
spectra, the camera's shake is other cameras; faults of the sensor are made by the photographer, frame by frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import trimesh
from cboxlab.rendering.synthetic import Frame, FrameHooks, band_filters
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene, Surface
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from numpy.typing import NDArray

__all__ = ["CAUSES", "SIZE_PX", "Made", "Stack", "Truth"]

SIZE_PX = 128

Stack = NDArray[np.float64]
Draw = np.random.Generator
ROWS, COLUMNS = np.indices((SIZE_PX, SIZE_PX))


@dataclass(frozen=True)
class Truth:
    """What a cause is. centre_px : None where it is everywhere. band : its only band, None for several."""

    family: str
    surface: str | None = None
    centre_px: tuple[float, float] | None = None
    band: str | None = None


@dataclass(frozen=True)
class Made:
    """A cause at work: a changed box or another camera (``pictures``), changed light, a changed camera (``hooks``).

    pictures : (scene, camera, weight, also (band, 1, 1)) whose light adds up; empty for the sound box.
    """

    truth: Truth
    pictures: Sequence[tuple[Scene, Camera, float | Stack]] = ()
    light: Callable[[Stack], Stack] = lambda signals: signals
    hooks: FrameHooks = field(default_factory=FrameHooks)


Maker = Callable[[Draw, Scene, Camera], Made]


def _with(scene: Scene, name: str, mesh: trimesh.Trimesh, reflectance: NDArray[np.float64]) -> Scene:
    """The scene with one more thing, of a new paint."""
    like = scene.materials["white"]
    paint = replace(like, name=name, reflectance=Spectrum(WAVELENGTH_NM, np.clip(reflectance, 0, 1)))
    mesh_surface = Surface(name, name, np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64))
    return replace(scene, surfaces=(*scene.surfaces, mesh_surface), materials={**scene.materials, name: paint})


def _centre(camera: Camera, points: NDArray[np.float64]) -> tuple[float, float]:
    u, v = camera.project(points).mean(axis=0)
    return float(u), float(v)


def _white(scene: Scene) -> NDArray[np.float64]:
    return np.asarray(scene.materials["white"].reflectance.at(WAVELENGTH_NM))


def ball(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """Somebody left a grey ball on the floor."""
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=float(draw.uniform(14, 22)))
    mesh.apply_translation([draw.uniform(380, 450), mesh.bounds[1][1] + 0.5, draw.uniform(60, 130)])
    altered = _with(scene, "ball", mesh, np.full(WAVELENGTH_NM.size, 0.35))
    return Made(Truth("object", None, _centre(camera, np.asarray(mesh.vertices))), [(altered, camera, 1.0)])


def rod(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """A dark rod leans against the back wall."""
    mesh = trimesh.creation.box([6.0, float(draw.uniform(150, 250)), 6.0])
    mesh.apply_translation([draw.uniform(60, 120), -mesh.bounds[0][1] + 1, 545])
    altered = _with(scene, "rod", mesh, np.full(WAVELENGTH_NM.size, 0.08))
    return Made(Truth("object", None, _centre(camera, np.asarray(mesh.vertices))), [(altered, camera, 1.0)])


def _disc(radius: float, centre: Sequence[float], normal: Sequence[float]) -> trimesh.Trimesh:
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    n = np.asarray(normal, float)
    first = np.cross(n, [0.3, 0.5, 0.8])
    first /= np.linalg.norm(first)
    second = np.cross(n, first)
    ring = radius * (np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second)
    vertices = np.asarray(centre, float) + np.vstack([np.zeros(3), ring])
    faces = [[0, i + 1, (i + 1) % 24 + 1] for i in range(24)]
    return trimesh.Trimesh(vertices, faces, process=False)


def floor_stain(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """Coffee on the floor: a disc of darker, yellower paint."""
    mesh = _disc(float(draw.uniform(25, 45)), [draw.uniform(380, 460), 0.2, draw.uniform(80, 180)], [0, 1, 0])
    paint = _white(scene) * (1 - 0.12 * np.exp(-(((WAVELENGTH_NM - 420) / 90) ** 2)) - 0.02)
    altered = _with(scene, "coffee", mesh, paint)
    return Made(
        Truth("reflectance-map", "floor", _centre(camera, np.asarray(mesh.vertices))),
        [(altered, camera, 1.0)],
    )


def wall_stain(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """A damp place on the back wall."""
    mesh = _disc(float(draw.uniform(30, 60)), [draw.uniform(100, 450), draw.uniform(380, 460), 558.8], [0, 0, -1])
    altered = _with(scene, "damp", mesh, _white(scene) * (0.96 - 0.00015 * (WAVELENGTH_NM - 400)))
    return Made(Truth("reflectance-map", "back", _centre(camera, np.asarray(mesh.vertices))), [(altered, camera, 1.0)])


def _repainted(scene: Scene, material: str, factor: NDArray[np.float64]) -> Scene:
    old = scene.materials[material]
    values = np.clip(old.reflectance.at(WAVELENGTH_NM) * factor, 0, 1)
    new = replace(old, reflectance=Spectrum(WAVELENGTH_NM, values))
    return replace(scene, materials={**scene.materials, material: new})


def bleached(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """One of the coloured paints faded about one wavelength."""
    material, surface, nm = (("red", "left", 625.0), ("green", "right", 530.0))[int(draw.integers(2))]
    factor = 1 - 0.05 * np.exp(-(((WAVELENGTH_NM - nm - draw.uniform(-15, 15)) / 28) ** 2))
    return Made(Truth("paint-spectrum", surface), [(_repainted(scene, material, factor), camera, 1.0)])


def second_lamp(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """A small bluish lamp in another place of the ceiling."""
    lamp, centre = scene.lamp, scene.lamp.surface.vertices_mm.mean(axis=0)
    vertices = (lamp.surface.vertices_mm - centre) * 0.4 + centre + [draw.uniform(100, 160), 0, draw.uniform(-120, 120)]
    spectrum = lamp.radiance.at(WAVELENGTH_NM) * (WAVELENGTH_NM / 550.0) ** -2.5
    other = replace(
        lamp, surface=replace(lamp.surface, vertices_mm=vertices), radiance=Spectrum(WAVELENGTH_NM, spectrum)
    )
    return Made(Truth("extra-light"), [(scene, camera, 1.0), (replace(scene, lamp=other), camera, 0.06)])


def _emitting(scene: Scene, corners: NDArray[np.float64], radiance: NDArray[np.float64]) -> Scene:
    """The scene lit by a flat piece alone. corners : (4, 3), mm, counterclockwise seen from where it shines."""
    surface = replace(scene.lamp.surface, vertices_mm=corners, faces=np.array([[0, 1, 2], [0, 2, 3]]))
    lamp = replace(scene.lamp, surface=surface, radiance=Spectrum(WAVELENGTH_NM, radiance))
    return replace(scene, lamp=lamp)


def sun_blade(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """Daylight falls through a slit onto the right wall, which shines there by so much more."""
    high, deep = draw.uniform(250, 400), draw.uniform(150, 400)
    along = 90 * np.array([0, np.sin(angle := draw.uniform(0.3, 1.2)), np.cos(angle)])
    across = 12 * np.array([0, np.cos(angle), -np.sin(angle)])
    middle = np.array([1.0, high, deep])
    corners = np.array([middle + a * along + b * across for a, b in ((-1, 1), (1, 1), (1, -1), (-1, -1))])
    wall = scene.materials["green"].reflectance.at(WAVELENGTH_NM)
    radiance = scene.lamp.radiance.at(WAVELENGTH_NM) * wall * (WAVELENGTH_NM / 550.0) ** -3
    blade = _emitting(scene, corners, radiance)
    truth = Truth("extra-light", None, _centre(camera, corners))
    return Made(truth, [(scene, camera, 1.0), (blade, camera, 0.008)])


def pilot_light(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """A small green light shines at the right wall from 40 mm before it."""
    middle = np.array([40.0, draw.uniform(150, 400), draw.uniform(150, 400)])
    square = 4 * np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]], float)
    corners = middle + square[::-1]
    radiance = 15 * scene.lamp.radiance.at(WAVELENGTH_NM).mean() * np.exp(-(((WAVELENGTH_NM - 530) / 25) ** 2))
    truth = Truth("extra-light", None, _centre(camera, middle[None] * [0.0, 1.0, 1.0]))
    return Made(truth, [(scene, camera, 1.0), (_emitting(scene, corners, radiance), camera, 0.06)])


def soot(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """The ceiling is blackened next to the lamp, most in the middle."""
    middle = [draw.uniform(430, 470), 548.4, draw.uniform(120, 330)]
    paint, altered, size = _white(scene), scene, draw.uniform(45, 70)
    for step in range(4):
        mesh = _disc(size * (1 - 0.2 * step), np.subtract(middle, [0, 0.3 * step, 0]), [0, -1, 0])
        altered = _with(altered, f"soot-{step}", mesh, paint * (1 - 0.03 * (step + 1)))
    truth = Truth("reflectance-map", "ceiling", _centre(camera, np.array([middle])))
    return Made(truth, [(altered, camera, 1.0)])


def thread(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """A dark thread crosses the opening, not quite upright."""
    mesh = trimesh.creation.cylinder(0.6, 700, sections=8)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(draw.uniform(0.03, 0.08), [0, 0, 1]))
    mesh.apply_translation([draw.uniform(120, 430), 300, -60])
    return Made(Truth("object"), [(_with(scene, "thread", mesh, np.full(WAVELENGTH_NM.size, 0.05)), camera, 1.0)])


def lamp_lines(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """The lamp has gas lines that its table lacks."""
    values = scene.lamp.radiance.at(WAVELENGTH_NM)
    for nm in (436.0, 546.0, 578.0):
        values = values + 0.25 * values.mean() * np.exp(-(((WAVELENGTH_NM - nm) / 2.5) ** 2))
    return Made(Truth("lamp-spectrum"), [(scene.with_lamp(Spectrum(WAVELENGTH_NM, values)), camera, 1.0)])


def shaking(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """The camera swings along one line while the shutter is open: five pictures in one."""
    angle, reach = draw.uniform(0, np.pi), draw.uniform(0.35, 0.6) / camera.focal_length_px
    turns = np.degrees(reach * np.array([np.cos(angle), np.sin(angle), 0.0]))
    results = []
    for part in np.linspace(-1, 1, 5):
        moved = camera.parameters.copy()
        moved[3:6] += part * turns
        results.append((scene, camera.with_parameters(moved), 0.2))
    return Made(Truth("blur"), results)


def _on_light(truth: Truth, light: Callable[[Stack], Stack]) -> Made:
    return Made(truth, light=light)


def tilted_sensor(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """Sharp at one side only: discs of confusion that grow across the picture."""
    from scipy.ndimage import uniform_filter

    def light(signals: Stack) -> Stack:
        wide = uniform_filter(signals, (0, 3, 3), mode="nearest")
        share = 0.5 * (COLUMNS / SIZE_PX) ** 2
        return (1 - share) * signals + share * wide

    return _on_light(Truth("blur"), light)


def wiped(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """A greasy cloth drew streaks over the lens: a little of all light is scattered along one line, far."""
    angle, share = draw.uniform(0, np.pi), draw.uniform(0.02, 0.04)
    way = np.array([np.sin(angle), np.cos(angle)])

    def light(signals: Stack) -> Stack:
        from scipy.ndimage import shift

        away = np.arange(-45, 46)
        weights = np.exp(-np.abs(away) / 12.0)
        scattered = sum(w * shift(signals, (0, *(a * way)), order=1) for a, w in zip(away, weights, strict=True))
        return (1 - share) * signals + share * np.asarray(scattered) / weights.sum()

    return _on_light(Truth("blur"), light)


def wedge(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """One filter is a wedge and moves its picture."""
    band, by = int(draw.integers(7)), draw.uniform(0.06, 0.12, 2) * draw.choice([-1, 1], 2)
    moved = replace(camera, principal_point_px=camera.principal_point_px + by[::-1])
    values = (np.arange(7) == band).astype(float)[:, None, None]
    return Made(Truth("displacement", band=_name(band)), [(scene, camera, 1 - values), (scene, moved, values)])


def fringes(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """Interference in one filter: rings about a point next to the picture."""
    band, at = int(draw.integers(7)), draw.uniform(-60, -20, 2)
    waves = draw.uniform(10, 16)

    def light(signals: Stack) -> Stack:
        changed = signals.copy()
        square = (ROWS - at[0]) ** 2 + (COLUMNS - at[1]) ** 2
        changed[band] *= 1 + 0.012 * np.cos(2 * np.pi * waves * square / (2.5 * SIZE_PX**2))
        return changed

    return _on_light(Truth("sensor-gain", band=_name(band)), light)


def dust(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """A grain that fell on the sensor after the flats: a soft shadow."""
    x, y = draw.uniform(25, 100, 2)

    def light(signals: Stack) -> Stack:
        away = np.hypot(COLUMNS - x, ROWS - y)
        return signals * (1 - 0.08 * np.clip(4.5 - away, 0, 1))

    return _on_light(Truth("sensor-gain", None, (float(x), float(y))), light)


def _frames(change: Callable[[Frame, Stack], Stack]) -> FrameHooks:
    return FrameHooks(counts=lambda frame, counts: change(frame, counts) if frame.kind == "band" else counts)


def row_noise(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """Rows are read with different offsets, the same in all frames of the scene."""
    offsets = draw.normal(0, 3.0, SIZE_PX)
    return Made(Truth("sensor-offset"), hooks=_frames(lambda frame, counts: counts + offsets[:, None]))


def column_gain(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """Columns have different amplifiers, which drifted since the flats."""
    gains = 1 + draw.normal(0, 0.006, SIZE_PX)
    hooks = FrameHooks(light=lambda frame, light: light * gains if frame.kind == "band" else light)
    return Made(Truth("sensor-gain"), hooks=hooks)


def glow(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """An amplifier glows at a corner of the sensor while the scene is taken."""
    corner = draw.integers(2, size=2) * (SIZE_PX - 1)
    away = np.hypot(ROWS - corner[0], COLUMNS - corner[1])
    pattern = 60.0 / (1 + (away / 12) ** 2)
    truth = Truth("sensor-offset", None, (float(corner[1]), float(corner[0])))
    return Made(truth, hooks=_frames(lambda frame, counts: counts + pattern))


def lamp_step(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """The lamp falls to a lower level in the middle of the sequence and recovers later."""
    first, last = sorted(draw.uniform(20, 160, 2))

    def light(frame: Frame, signal: Stack) -> Stack:
        inside = frame.kind == "band" and frame.start_s is not None and first < frame.start_s < last + 30
        return signal * (0.98 if inside else 1.0)

    return Made(Truth("time-order"), hooks=FrameHooks(light=light))


def flicker(draw: Draw, scene: Scene, camera: Camera) -> Made:
    """The lamp's level is another in every frame."""
    levels = iter(1 + draw.normal(0, 0.012, 200))
    hooks = FrameHooks(light=lambda frame, light: light * next(levels) if frame.kind == "band" else light)
    return Made(Truth("time-order"), hooks=hooks)


def _name(band: int) -> str:
    return tuple(band_filters())[band]


CAUSES: Mapping[str, Maker] = {
    maker.__name__: maker
    for maker in (
        ball,
        rod,
        thread,
        floor_stain,
        wall_stain,
        soot,
        bleached,
        second_lamp,
        sun_blade,
        pilot_light,
        lamp_lines,
        shaking,
        tilted_sensor,
        wiped,
        wedge,
        fringes,
        dust,
        row_noise,
        column_gain,
        glow,
        lamp_step,
        flicker,
    )
}
