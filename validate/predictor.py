"""Predicts a capture's corrected signals under any effects, as a change of one accurately rendered picture.

The base picture is rendered once, to the noise asked for. What effects of the scene or of light transport
change is computed from the patches' exchange at each band's effective wavelength, cached by geometry and lamp
shape, and added; filter, optics and counts effects act exactly. Effects that move the camera change nothing here: the
picture is seen through the camera that was fitted to the capture, wherever an effect says that it should be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from cboxlab.calibration.sensor_equation import WAVELENGTH_NM, sensor_matrix
from cboxlab.render.final_gather import LightField, solve_light
from cboxlab.render.image import RenderedImage
from cboxlab.render.patch_light import PatchLight, patch_light
from cboxlab.render.patch_transport import PatchTransport, build_patch_transport
from cboxlab.render.warp import Warp, build_warp
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from .effects import AppliedEffect, Light
from .expected import expected_signal, integral_responses, scene_light, with_scene_behind
from .model import RenderSettings
from .sensing import Sensing

__all__ = ["Predictor", "build_predictor"]

#: Patches and rays of the change, coarse beside the base picture's: errors of a few percent of a change.
_PATCHES_PER_DIAGONAL = 12
_PATCH_SAMPLES = 512
_SAMPLES = 256
_SCREENING_SAMPLES = 64

#: Standard deviation of the averaging where geometry moves. Of the error's square 1.0 leaves a sixth (a block moved by
#: 1 mm); twice as much blurs the edges of shadows.
_NEIGHBOURS_PX = 1.0

_SCENE_STAGES = ("scene", "settings", "transport")


@dataclass(frozen=True, eq=False)
class Predictor:
    """scene, settings : without effects. included : effects of scene or settings that the base picture holds already.

    image, camera : the base picture. base : its Light. samples : rays a pixel of what no patches tell.
    """

    scene: Scene
    sensing: Sensing
    camera: Camera
    light: LightField
    image: RenderedImage
    base: Light
    settings: RenderSettings
    included: tuple[AppliedEffect, ...]
    effective_nm: NDArray[np.float64]
    warp: Warp
    samples: int = 256
    _transports: dict[tuple, PatchTransport] = field(default_factory=dict)
    _pictures: dict[tuple, NDArray[np.float64]] = field(default_factory=dict)
    _seen: dict[tuple, NDArray[np.int64]] = field(default_factory=dict)

    def rough(self) -> Predictor:
        """The same with fewer rays, enough to tell which effects deserve a closer look."""
        return replace(self, samples=_SCREENING_SAMPLES, _pictures={})

    def resampled(self) -> Predictor:
        """The same with other random numbers for what effects of the scene change."""
        settings = replace(self.settings, seed=self.settings.seed + 1)
        return replace(self, settings=settings, _transports={}, _pictures={}, _seen={})

    def signal(self, effects: Sequence[AppliedEffect]) -> NDArray[np.float64]:
        """Expected corrected signals (band, y, x) in DN, the lamp at its stated power, not clipped."""
        return expected_signal(self.before_optics(effects), self.sensing, effects, self.camera)

    def noise(self, effects: Sequence[AppliedEffect], before: NDArray[np.float64]) -> NDArray[np.float64]:
        """What optics and counts make of an error ``before`` (band, y, x) of the picture, DN."""
        light = self.base.with_signal(self.base.signal + before)
        ends = (expected_signal(each, self.sensing, effects, self.camera) for each in (light, self.base))
        return np.subtract(*ends)

    def before_optics(self, effects: Sequence[AppliedEffect]) -> Light:
        """The same before optics and counts: in proportion to the exposure, whatever the effects."""
        filters = [e for e in effects if e.effect.stage == "filter"]
        light = scene_light(self.image, self.sensing, filters, self.camera) if filters else self.base
        changed = light.signal
        relevant = tuple(e for e in effects if e.effect.stage in _SCENE_STAGES)
        if _key(relevant) != _key(self.included):
            faces = self._faces(self.included), self._faces(relevant)
            face = None if faces[0] is faces[1] else np.where(np.equal(*faces), faces[0], -1)
            changed = _changed(changed, self._picture(self.included), self._picture(relevant), face)
        return replace(self.base, signal=changed, effective_nm=light.effective_nm)

    def _picture(self, effects: Sequence[AppliedEffect]) -> NDArray[np.float64]:
        """(band, y, x) DN of the patches' picture."""
        key = _key(effects)
        if key not in self._pictures:
            if len(self._pictures) > 40:
                self._pictures.clear()
            self._pictures[key] = self._patch_picture(effects)
        return self._pictures[key]

    def _patch_picture(self, effects: Sequence[AppliedEffect]) -> NDArray[np.float64]:
        scene = self._scene(effects)
        e = scene.lamp.edge_ratio
        if e in (0.0, 1.0):
            return self._picture_of(scene, effects)
        # all light is in proportion to the lamp's, whose pattern mixes two: no new rays, no noise between them
        even = e / (e + (1 - e) * 4 / 9)
        level, domed = (self._picture_of(_with_edge(scene, end), effects) for end in (1.0, 0.0))
        return even * level + (1 - even) * domed

    def _scene(self, effects: Sequence[AppliedEffect]) -> Scene:
        scene = self.scene
        for effect in effects:
            if effect.effect.stage == "scene":
                scene = effect.apply(scene)
        return scene

    def _faces(self, effects: Sequence[AppliedEffect]) -> NDArray[np.int64]:
        """(y, x) flat face that each pixel sees alone, -1 for none; the same array for the same geometry."""
        scene = self._scene(effects)
        key = _meshes(scene)
        if key not in self._seen:
            transport = self._transport(_with_edge(scene, 1.0))
            face = np.full(transport.covered.shape, -1)
            alone = transport.coverage == 1
            face.flat[transport.pixel[alone]] = transport.face[alone]
            self._seen[key] = face
        return self._seen[key]

    def _picture_of(self, scene: Scene, effects: Sequence[AppliedEffect]) -> NDArray[np.float64]:
        """The same in a scene that holds the effects of the scene."""
        settings = self.settings
        for effect in effects:
            if effect.effect.stage == "settings":
                settings = effect.apply(settings)
        weights = sensor_matrix(integral_responses(self.sensing.curves))
        lamp = scene.lamp.radiance.at(WAVELENGTH_NM)
        light: PatchLight = patch_light(self._transport(scene), scene, self.effective_nm, WAVELENGTH_NM, weights, lamp,
                                        settings.max_bounces, self.samples)  # fmt: skip
        for effect in effects:
            if effect.effect.stage == "transport":
                light = effect.apply(light)
        return (weights @ lamp)[:, None, None] * light.picture()

    def _transport(self, scene: Scene) -> PatchTransport:
        lamp = scene.lamp
        key = (lamp.edge_ratio, lamp.exponent, *(s.material for s in scene.surfaces), *_meshes(scene))
        if key not in self._transports:
            if len(self._transports) > 6:
                for old in list(self._transports)[1:]:  # the first is the base's own
                    del self._transports[old]
            self._transports[key] = _coarse_transport(
                scene, self.effective_nm, self.camera, self.settings.seed
            )
        return self._transports[key]


def _key(effects: Sequence[AppliedEffect]) -> tuple:
    return tuple((e.id, tuple(e.values.items())) for e in effects)


def _meshes(scene: Scene) -> tuple[bytes, ...]:
    return tuple(s.vertices_mm.tobytes() for s in (*scene.surfaces, scene.lamp.surface))


def _with_edge(scene: Scene, ratio: float) -> Scene:
    return replace(scene, lamp=replace(scene.lamp, edge_ratio=ratio))


def _changed(signal: NDArray, before: NDArray, after: NDArray, face: NDArray | None) -> NDArray[np.float64]:
    """The signal changed as the patches' picture changes: by its ratio, in which the coarse picture's own errors
    cancel; by the difference where there was next to nothing before, or where edges moved.

    face : (y, x) what a pixel sees alone before and after, -1 for nothing; None where nothing moved.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = after / before
    steady = np.isfinite(ratio) & (ratio > 0.5) & (ratio < 2.0)
    if face is not None:
        ratio = _averaged(ratio, np.where(steady.all(axis=0), face, -1))
    return np.where(steady, signal * np.where(steady, ratio, 1.0), signal + after - before)


def _averaged(ratio: NDArray, face: NDArray) -> NDArray[np.float64]:
    """Ratios (band, y, x) averaged over neighbours on the same face: which of a pixel's rays a moved edge stops
    is noise of that pixel alone, and for a motion of a millimetre more than the change itself."""
    result = ratio.copy()
    for one in np.unique(face[face >= 0]):
        own = face == one
        weight = gaussian_filter(own.astype(float), _NEIGHBOURS_PX, mode="constant")[own]
        values = gaussian_filter(
            np.where(own, ratio, 0.0), (0, _NEIGHBOURS_PX, _NEIGHBOURS_PX), mode="constant"
        )
        result[:, own] = values[:, own] / weight
    return result


def _coarse_transport(scene: Scene, wavelength_nm: NDArray, camera: Camera, seed: int) -> PatchTransport:
    extent = np.concatenate([s.vertices_mm for s in scene.surfaces])
    edge = float(np.linalg.norm(np.ptp(extent, axis=0))) / _PATCHES_PER_DIAGONAL
    light = solve_light(scene, wavelength_nm, patch_edge_mm=edge, patch_samples=_PATCH_SAMPLES, seed=seed)
    return build_patch_transport(light, camera, _SAMPLES, seed)


def build_predictor(
    light: LightField,
    image: RenderedImage,
    camera: Camera,
    sensing: Sensing,
    scene: Scene,
    settings: RenderSettings,
    included: Sequence[AppliedEffect] = (),
) -> Predictor:
    """From the base picture, as gathered from ``light`` through ``camera``; see Predictor."""
    base = scene_light(image, sensing, (), camera)
    warp = build_warp(light.tracer, camera, image, base.signal)
    base = with_scene_behind(base, warp)
    return Predictor(
        scene, sensing, camera, light, image, base, settings, tuple(included), base.effective_nm, warp
    )
