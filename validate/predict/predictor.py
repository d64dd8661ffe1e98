"""Predicts a capture's corrected signals under any effects, as a change of one accurately rendered picture.

The base picture is rendered once, to the noise asked for. The change made by effects of the scene or of light
transport is computed by patch transport at each band's effective wavelength, kept by geometry and lamp shape, and
applied to the base picture. Effects of filters, optics and counts are computed exactly. Effects of the camera do not
change the ten fitted camera parameters, which are nuisances; only distortion beyond these parameters is warped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from cboxlab.calibration.instrument import sensor_matrix
from cboxlab.rendering.chain import (
    Light,
    RenderSettings,
    Sensing,
    after_stage,
    expected_signal,
    scene_light,
    stages_between,
    with_scene_behind,
)
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.image import RenderedImage
from cboxlab.rendering.model import with_further_distortion
from cboxlab.rendering.perturbation import (
    PatchLight,
    PatchTransport,
    Warp,
    band_shares,
    build_patch_transport,
    build_warp,
    patch_light,
    warp_change,
)
from cboxlab.rendering.radiosity import LightField, build_patched_scene
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

__all__ = ["Predictor", "averaged_on_faces", "build_predictor", "changed_alike", "coarse_transport"]

#: Patches and rays for changes. They are coarser than for the base picture: a change is wrong by a few percent.
_PATCHES_PER_DIAGONAL = 12
_PATCH_SAMPLES = 512
_SAMPLES = 256
_SCREENING_SAMPLES = 64
_DRAFT_SAMPLES = 64

#: Standard deviation, px, of the smoothing of changes where geometry moves. 1.0 reduces the mean square error for a
#: block moved by 1 mm to a sixth; 2.0 would blur the edges of shadows.
_NEIGHBOURS_PX = 1.0

#: So many transports, pictures by them, and maps of faces are kept; a transport has some 1000 bytes a pixel. A geometry
#: takes two transports where the lamp's pattern is a mixture, and effects of two geometries are tried in turn.
_MOST_TRANSPORTS, _MOST_PICTURES, _MOST_FACES = 4, 12, 12

_SCENE_STAGES = stages_between("scene", "transport")


_T = TypeVar("_T")


class _Traced:
    """What was traced for one camera and seed, by geometry and lamp shape, to be used again."""

    def __init__(self) -> None:
        self.transports: dict[tuple, PatchTransport] = {}
        self.faces: dict[tuple, NDArray[np.int64]] = {}


@dataclass(frozen=True, eq=False)
class Predictor:
    """scene, settings : without effects. included : effects of scene or settings that are in the base picture.

    image, camera : the base picture. base : its Light. samples : rays per pixel for what
    patches do not describe. gather_samples : rays per pixel of patch transport where geometry has moved.
    moved : (band, y, x) DN that another camera changes of the base picture, see ``seen_by``. lamp_scale : factor on the
    lamp's stated power, at which effects act: light from elsewhere and offsets of counts do not grow with the lamp.
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
    gather_samples: int = _SAMPLES
    moved: NDArray[np.float64] | float = 0.0
    lamp_scale: float = 1.0
    _traced: _Traced = field(default_factory=_Traced, init=False)
    _pictures: dict[tuple, NDArray[np.float64]] = field(default_factory=dict, init=False)

    def _sharing(self, *stores: str, **changes: Any) -> Predictor:
        """The same with changes, and with the stores of what was traced that do not depend on them."""
        other = replace(self, **changes)
        for store in stores:
            object.__setattr__(other, store, getattr(self, store))
        return other

    def rough(self) -> Predictor:
        """The same with fewer rays per pixel, for screening."""
        return self._sharing("_traced", samples=_SCREENING_SAMPLES)  # patches do not depend on the samples

    def draft(self) -> Predictor:
        """The same with fewer rays per pixel for what is traced anew, too: three times as fast, twice the noise."""
        return replace(self, samples=_SCREENING_SAMPLES, gather_samples=_DRAFT_SAMPLES)

    def traces_anew(self, effects: Sequence[AppliedEffect]) -> bool:
        """Whether surfaces stand elsewhere than in the base picture, or lamps shine in other directions."""
        here, there = (after_stage(self.scene, each, "scene") for each in (self.included, effects))
        exponents = ([lamp.exponent for lamp in scene.lamps] for scene in (here, there))
        return _meshes(here) != _meshes(there) or next(exponents) != next(exponents)

    def with_settings(self, settings: RenderSettings) -> Predictor:
        """The same base picture, taken for one rendered with other settings."""
        return self._sharing("_traced", settings=settings)  # rays do not depend on the depth of paths

    def seen_by(self, camera: Camera) -> Predictor:
        """The base picture warped to a camera a few hundredths of a pixel off, before any effect acts on it."""
        return self._sharing("_traced", "_pictures", moved=warp_change(self.warp, camera))

    def at_lamp(self, scale: float) -> Predictor:
        """The same at another power of the lamp. scale : factor on its stated power."""
        return self._sharing("_traced", "_pictures", lamp_scale=scale)

    def resampled(self) -> Predictor:
        """The same with other random numbers for changes by effects of the scene."""
        settings = replace(self.settings, seed=self.settings.seed + 1)
        return replace(self, settings=settings)

    @property
    def transport(self) -> PatchTransport:
        """The exchange of the scene with the effects that are in the base picture."""
        return self._transport(after_stage(self.scene, self.included, "scene"))

    @property
    def lamp_shares(self) -> NDArray[np.float64]:
        """(lamps, band) signal of each lamp over that of the lamps' mean, with the effects in the base picture."""
        scene = after_stage(self.scene, self.included, "scene")
        weights = sensor_matrix(self.sensing.curves.responses())
        return band_shares(scene, WAVELENGTH_NM, weights, scene.lamp_radiance(WAVELENGTH_NM))

    def signal(self, effects: Sequence[AppliedEffect]) -> NDArray[np.float64]:
        """Expected corrected signals (band, y, x) in DN over ``lamp_scale``, not clipped."""
        light = self.before_optics(effects)
        return expected_signal(light, self.sensing, effects, self.camera) / self.lamp_scale

    def signal_and_noise(
        self, effects: Sequence[AppliedEffect], before: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(band, y, x) DN over ``lamp_scale`` each: the base picture's signals behind effects of optics and counts, and
        their error due to an error ``before`` of the picture ahead of the optics."""
        base = self.base.scaled(self.lamp_scale)
        light = base.with_signal(base.signal + self.lamp_scale * before)
        noisy, signal = (
            expected_signal(each, self.sensing, effects, self.camera) / self.lamp_scale for each in (light, base)
        )
        return signal, noisy - signal

    def before_optics(self, effects: Sequence[AppliedEffect]) -> Light:
        """The band light before optics and counts, of the lamp times ``lamp_scale``. It is proportional to the exposure
        under all effects."""
        curves = after_stage(self.sensing.curves, effects, "filter")
        filtered = curves is not self.sensing.curves
        light = scene_light(self.image, curves, self.camera) if filtered else self.base
        changed = light.signal + self.moved
        relevant = tuple(e for e in effects if e.stage in _SCENE_STAGES)
        at_scale = self.lamp_scale if any(e.stage == "transport" for e in relevant) else 1.0
        if _key(relevant) != _key(self.included) or at_scale != 1.0:
            faces = self._faces(self.included), self._faces(relevant)
            face = None if faces[0] is faces[1] else np.where(np.equal(*faces), faces[0], -1)
            changed = changed_alike(
                changed, self.patch_picture(self.included), self.patch_picture(relevant, at_scale), face
            )
        there = with_further_distortion(self.camera, effects)
        if there is not self.camera:
            changed = changed + warp_change(self.warp, there)
        light = replace(self.base, signal=changed, effective_nm=light.effective_nm)
        return light.scaled(self.lamp_scale)

    def patch_picture(self, effects: Sequence[AppliedEffect], lamp_scale: float = 1.0) -> NDArray[np.float64]:
        """(band, y, x) DN over ``lamp_scale``, a factor on the lamp's power: the picture by patch transport."""
        key = (*_key(effects), lamp_scale)

        def made() -> NDArray[np.float64]:
            return self._mixed_picture(effects, lamp_scale) / lamp_scale

        return _kept(self._pictures, key, _MOST_PICTURES, made)

    def _mixed_picture(self, effects: Sequence[AppliedEffect], lamp_scale: float) -> NDArray[np.float64]:
        scene = after_stage(self.scene, effects, "scene")
        scene = scene.with_lamps(lambda lamp: replace(lamp, radiance=lamp.radiance.scaled(lamp_scale)))
        e = scene.lamp.edge_ratio
        if e in (0.0, 1.0) or any(lamp.edge_ratio != e for lamp in scene.lamps):
            return self.patch_picture_of(scene, effects)
        # light is linear in the lamps' patterns, each a mixture of two patterns: the same rays serve both
        even = e / (e + (1 - e) * 4 / 9)
        level, domed = (self.patch_picture_of(_with_edge(scene, end), effects) for end in (1.0, 0.0))
        return even * level + (1 - even) * domed

    def _faces(self, effects: Sequence[AppliedEffect]) -> NDArray[np.int64]:
        """(y, x) index of the one flat face that a pixel sees, -1 for several; one array for each geometry."""
        scene = after_stage(self.scene, effects, "scene")

        def found() -> NDArray[np.int64]:
            transport = self._transport(_with_edge(scene, 1.0))
            face = np.full(transport.covered.shape, -1)
            alone = transport.coverage == 1
            face.flat[transport.pixel[alone]] = transport.face[alone]
            return face

        return _kept(self._traced.faces, _meshes(scene), _MOST_FACES, found)

    def patch_picture_of(self, scene: Scene, effects: Sequence[AppliedEffect]) -> NDArray[np.float64]:
        """The picture by patch transport of a scene that has the effects of the scene stage."""
        settings = after_stage(self.settings, effects, "settings")
        weights = sensor_matrix(self.sensing.curves.responses())
        lamp = scene.lamp_radiance(WAVELENGTH_NM)
        light: PatchLight = patch_light(
            self._transport(scene),
            scene,
            self.effective_nm,
            WAVELENGTH_NM,
            weights,
            lamp,
            max_bounces=settings.max_bounces,
            samples=self.samples,
        )
        light = after_stage(light, effects, "transport")
        return (weights @ lamp)[:, None, None] * light.picture()

    def _transport(self, scene: Scene) -> PatchTransport:
        key = (
            *((lamp.edge_ratio, lamp.exponent, lamp.reflects) for lamp in scene.lamps),
            *(s.material for s in scene.surfaces),
            *_meshes(scene),
        )
        of = (scene, self.camera, self.settings.seed, self.gather_samples)
        return _kept(self._traced.transports, key, _MOST_TRANSPORTS, lambda: coarse_transport(*of))


def _kept(store: dict[tuple, _T], key: tuple, most: int, made: Callable[[], _T]) -> _T:
    """What ``made`` gives for a key, or gave before. Beyond ``most`` the one not used for longest goes, but never the
    first, which belongs to the base picture."""
    if key not in store:
        if len(store) >= most:
            del store[list(store)[1]]
        store[key] = made()
    elif key != next(iter(store)):
        store[key] = store.pop(key)
    return store[key]


def _key(effects: Sequence[AppliedEffect]) -> tuple:
    return tuple((e.id, tuple(e.values.items())) for e in effects)


def _meshes(scene: Scene) -> tuple[bytes, ...]:
    return tuple(s.vertices_mm.tobytes() for s in scene.all_surfaces)


def _with_edge(scene: Scene, ratio: float) -> Scene:
    return scene.with_lamps(lambda lamp: replace(lamp, edge_ratio=ratio))


def changed_alike(signal: NDArray, before: NDArray, after: NDArray, face: NDArray | None) -> NDArray[np.float64]:
    """The signal, changed as the picture by patch transport changes: by the ratio, in which errors of the coarse
    patches cancel; by the difference where the ratio is not between 0.5 and 2 (dark pixels, moved edges).

    face : (y, x) the one face that a pixel sees before and after, -1 for several; None if geometry did not move.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = after / before
    steady = np.isfinite(ratio) & (ratio > 0.5) & (ratio < 2.0)
    if face is not None:
        ratio = averaged_on_faces(ratio, np.where(steady.all(axis=0), face, -1))
    return np.where(steady, signal * np.where(steady, ratio, 1.0), signal + after - before)


def averaged_on_faces(ratio: NDArray, face: NDArray) -> NDArray[np.float64]:
    """Ratios (band, y, x), smoothed over neighbours on the same face.

    Which rays of a pixel a moved edge blocks is random and independent between pixels; for a motion of 1 mm this noise
    exceeds the change itself."""
    result = ratio.copy()
    for one in np.unique(face[face >= 0]):
        own = face == one
        weight = gaussian_filter(own.astype(float), _NEIGHBOURS_PX, mode="constant")[own]
        values = gaussian_filter(np.where(own, ratio, 0.0), (0, _NEIGHBOURS_PX, _NEIGHBOURS_PX), mode="constant")
        result[:, own] = values[:, own] / weight
    return result


def coarse_transport(scene: Scene, camera: Camera, seed: int, samples: int = _SAMPLES) -> PatchTransport:
    """The exchange of a scene in coarse patches, as changes of the picture are computed with.

    samples : rays of each pixel.
    """
    edge = float(np.linalg.norm(np.ptp(scene.corners_mm, axis=0))) / _PATCHES_PER_DIAGONAL
    return build_patch_transport(build_patched_scene(scene, edge, _PATCH_SAMPLES, seed), camera, samples, seed)


def build_predictor(
    light: LightField,
    image: RenderedImage,
    camera: Camera,
    sensing: Sensing,
    scene: Scene,
    settings: RenderSettings,
    included: Sequence[AppliedEffect] = (),
) -> Predictor:
    """The predictor of a base picture that was gathered from ``light`` through ``camera``."""
    base = scene_light(image, sensing.curves, camera)
    warp = build_warp(light.tracer, camera, image, base.signal)
    base = with_scene_behind(base, warp)
    return Predictor(scene, sensing, camera, light, image, base, settings, tuple(included), base.effective_nm, warp)
