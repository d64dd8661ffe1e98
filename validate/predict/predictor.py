"""Prediction of a capture's signals under any effects, as a change of one rendering.

The base picture is rendered once, to the requested noise. Patch transport at each band's effective wavelength computes
the change by effects of the scene or of light transport. The transport is stored by geometry and lamp shape, and the
change is applied to the base picture. Effects of filters, optics and counts are computed exactly. Effects of the camera
do not change the ten fitted camera parameters, which are nuisances; only distortion beyond them is warped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Generic, TypeVar

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

__all__ = ["Predictor", "averaged_on_faces", "build_predictor", "coarse_transport", "effects_key", "with_change_of"]

#: Patches along the scene's diagonal for changes: coarser than for the base picture, so that a change is wrong by a few
#: percent.
_PATCHES_PER_DIAGONAL = 12

#: Rays from each patch.
_PATCH_SAMPLES = 512

#: Rays of each pixel.
_SAMPLES = 256

#: Rays of each pixel for screening.
_SCREENING_SAMPLES = 64

#: Number of pixels up to which screening uses the transports of the complete prediction: in a larger picture fewer rays
#: of each pixel say as much.
_SMALL_PICTURE_PX = 2**15

#: Rays of each pixel for a draft where geometry has moved: three times as fast, twice the noise.
_DRAFT_SAMPLES = 64

#: Rays from each patch for a draft where geometry has moved. A block moved by 1 to 14 mm, or a lamp by 5 to 27 mm: the
#: root mean square error of the picture grows by 0 to 2 %, by 7 % at most, since rays of pixels make most of it.
_DRAFT_PATCH_SAMPLES = 128

#: Standard deviation, px, of the smoothing of changes where geometry moves. 1.0 reduces the mean square error for a
#: block moved by 1 mm to a sixth; 2.0 would blur the edges of shadows.
_NEIGHBOURS_PX = 1.0

#: Transports stored, of some 1000 bytes a pixel. A geometry takes up to six where the lamp's pattern is a mixture, and
#: effects of two geometries are tried in turn.
_NUM_TRANSPORTS = 6

#: Exponents of the lamps' directions that are traced. Pictures between them are parabolas through three: at most one
#: part in a hundred of the change is wrong, since cos(t)^n is smooth in n.
_TRACED_EXPONENTS = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8)

#: Pictures by patch transport stored.
_NUM_PICTURES = 12

#: Maps of faces stored.
_NUM_FACE_MAPS = 12

_SCENE_STAGES = stages_between("scene", "transport")


_T = TypeVar("_T")


class _Store(Generic[_T]):
    """Results by key, for repeated use.

    Beyond ``size`` results, the one not used for longest is dropped. The first result stays: it belongs to the base
    picture, to which every change refers.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.results: dict[tuple, _T] = {}

    def get(self, key: tuple, compute: Callable[[], _T]) -> _T:
        """Result for a key, computed where the store lacks it."""
        if key not in self.results:
            if len(self.results) >= self.size:
                del self.results[list(self.results)[1]]
            self.results[key] = compute()
        elif key != next(iter(self.results)):
            self.results[key] = self.results.pop(key)
        return self.results[key]


class _Traced:
    """Results of ray tracing for one camera and seed, by geometry and lamp shape."""

    def __init__(self) -> None:
        self.transports: _Store[PatchTransport] = _Store(_NUM_TRANSPORTS)
        self.faces: _Store[NDArray[np.int64]] = _Store(_NUM_FACE_MAPS)

    @cached_property
    def drafted(self) -> _Traced:
        """Results of fewer rays, for screening in large pictures."""
        return _Traced()


@dataclass(frozen=True, eq=False)
class Predictor:
    """Prediction of signals from one rendered picture."""

    #: Scene without effects.
    scene: Scene
    #: Constants of the sensor equation.
    sensing: Sensing
    #: Camera of the base picture.
    camera: Camera
    #: Radiosity solution of the base picture.
    light: LightField
    #: Base picture.
    image: RenderedImage
    #: Band light of the base picture.
    base: Light
    #: Settings of the rendering, without effects.
    settings: RenderSettings
    #: Effects of scene or settings that are in the base picture.
    included: tuple[AppliedEffect, ...]
    #: (band,) effective wavelength, nm, at which changes are computed.
    effective_nm: NDArray[np.float64]
    #: Warp of the base picture to cameras nearby.
    warp: Warp
    #: Rays per pixel for light that patches do not describe.
    samples: int = 256
    #: Rays per pixel of patch transport where geometry has moved.
    gather_samples: int = _SAMPLES
    #: Rays from each patch where geometry has moved.
    patch_samples: int = _PATCH_SAMPLES
    #: (band, y, x) change of the base picture by another camera, DN; see ``with_camera``.
    moved: NDArray[np.float64] | float = 0.0
    #: Factor on the lamp's stated power at which effects act: stray light and offsets do not grow with the lamp.
    lamp_scale: float = 1.0
    _traced: _Traced = field(default_factory=_Traced, init=False)
    _pictures: _Store[NDArray[np.float64]] = field(default_factory=lambda: _Store(_NUM_PICTURES), init=False)

    def _sharing(self, *stores: str, **changes: Any) -> Predictor:
        """The same with changes, sharing the stores that do not depend on them."""
        other = replace(self, **changes)
        for store in stores:
            object.__setattr__(other, store, getattr(self, store))
        return other

    def rough(self) -> Predictor:
        """The same with fewer rays per pixel where patches do not describe the light.

        Returns
        -------
        Predictor
            It shares the transports of this one.
        """
        return self._sharing("_traced", samples=_SCREENING_SAMPLES)  # patches do not depend on the samples

    def screening(self) -> Predictor:
        """The same with fewer rays per pixel, for screening.

        Returns
        -------
        Predictor
            As of `rough`. In a large picture its transports have fewer rays, too: all such predictors of this one share
            them.
        """
        if self.camera.width_px * self.camera.height_px <= _SMALL_PICTURE_PX:
            return self.rough()
        drafted = replace(self.draft(), patch_samples=self.patch_samples)
        object.__setattr__(drafted, "_traced", self._traced.drafted)
        return drafted

    def draft(self) -> Predictor:
        """The same with fewer rays per pixel, for moved geometry also.

        It is three times as fast, with twice the noise.

        Returns
        -------
        Predictor
            It traces its own rays.
        """
        return replace(
            self,
            samples=_SCREENING_SAMPLES,
            gather_samples=_DRAFT_SAMPLES,
            patch_samples=_DRAFT_PATCH_SAMPLES,
        )

    def needs_tracing(self, effects: Sequence[AppliedEffect]) -> bool:
        """Whether effects move surfaces, or change the directions in which lamps emit.

        Parameters
        ----------
        effects
            Effects, compared with those in the base picture.

        Returns
        -------
        bool
            True where rays have to be traced again.
        """
        before, after = (after_stage(self.scene, each, "scene") for each in (self.included, effects))
        exponents = ([lamp.exponent for lamp in scene.lamps] for scene in (before, after))
        return _meshes(before) != _meshes(after) or next(exponents) != next(exponents)

    def with_settings(self, settings: RenderSettings) -> Predictor:
        """The same base picture, declared as rendered with other settings.

        Parameters
        ----------
        settings
            The settings that the base picture corresponds to.

        Returns
        -------
        Predictor
            It shares the transports of this one.
        """
        return self._sharing("_traced", settings=settings)  # rays do not depend on the depth of paths

    def with_camera(self, camera: Camera) -> Predictor:
        """The same with the base picture warped to another camera, before any effect acts on it.

        Parameters
        ----------
        camera
            Camera whose picture differs by a few hundredths of a pixel.

        Returns
        -------
        Predictor
            It shares all stores of this one.
        """
        return self._sharing("_traced", "_pictures", moved=warp_change(self.warp, camera))

    def at_lamp(self, scale: float) -> Predictor:
        """The same at another power of the lamp.

        Parameters
        ----------
        scale
            Factor on the lamp's stated power.

        Returns
        -------
        Predictor
            It shares all stores of this one.
        """
        return self._sharing("_traced", "_pictures", lamp_scale=scale)

    def resampled(self) -> Predictor:
        """The same with other random numbers for changes by effects of the scene.

        Returns
        -------
        Predictor
            Its seed is the next one.
        """
        settings = replace(self.settings, seed=self.settings.seed + 1)
        return replace(self, settings=settings)

    @property
    def transport(self) -> PatchTransport:
        """The exchange of the scene with the effects that are in the base picture."""
        return self._transport(after_stage(self.scene, self.included, "scene"))

    @property
    def lamp_shares(self) -> NDArray[np.float64]:
        """(lamps, band) signal of each lamp over their mean, in the base picture."""
        scene = after_stage(self.scene, self.included, "scene")
        weights = sensor_matrix(self.sensing.curves.responses())
        return band_shares(scene, WAVELENGTH_NM, weights, scene.lamp_radiance(WAVELENGTH_NM))

    def signal(self, effects: Sequence[AppliedEffect]) -> NDArray[np.float64]:
        """Expected corrected signals over ``lamp_scale``, not clipped.

        Parameters
        ----------
        effects
            All effects, those of the base picture included.

        Returns
        -------
        NDArray
            (band, y, x) DN.
        """
        light = self.before_optics(effects)
        return expected_signal(light, self.sensing, effects, self.camera) / self.lamp_scale

    def signal_and_noise(
        self, effects: Sequence[AppliedEffect], before: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Signals behind optics and counts, and their error for an error ahead of them.

        Parameters
        ----------
        effects
            Effects of optics and counts.
        before
            (band, y, x) error of the picture ahead of the optics, DN over ``lamp_scale``.

        Returns
        -------
        NDArray
            (band, y, x) signals, DN over ``lamp_scale``.
        NDArray
            (band, y, x) their error, DN over ``lamp_scale``.
        """
        base = self.base.scaled(self.lamp_scale)
        light = base.with_signal(base.signal + self.lamp_scale * before)
        noisy, signal = (
            expected_signal(each, self.sensing, effects, self.camera) / self.lamp_scale for each in (light, base)
        )
        return signal, noisy - signal

    def before_optics(self, effects: Sequence[AppliedEffect]) -> Light:
        """Band light before optics and counts, of the lamp times ``lamp_scale``.

        It is proportional to the exposure under all effects.

        Parameters
        ----------
        effects
            All effects, those of the base picture included.

        Returns
        -------
        Light
            The band light.
        """
        curves = after_stage(self.sensing.curves, effects, "filter")
        filtered = curves is not self.sensing.curves
        light = scene_light(self.image, curves, self.camera) if filtered else self.base
        changed = light.signal + self.moved
        relevant = tuple(e for e in effects if e.stage in _SCENE_STAGES)
        at_scale = self.lamp_scale if any(e.stage == "transport" for e in relevant) else 1.0
        if effects_key(relevant) != effects_key(self.included) or at_scale != 1.0:
            faces = self._faces(self.included), self._faces(relevant)
            face = None if faces[0] is faces[1] else np.where(np.equal(*faces), faces[0], -1)
            changed = with_change_of(
                changed, self.patch_picture(self.included), self.patch_picture(relevant, at_scale), face
            )
        distorted = with_further_distortion(self.camera, effects)
        if distorted is not self.camera:
            changed = changed + warp_change(self.warp, distorted)
        light = replace(self.base, signal=changed, effective_nm=light.effective_nm)
        return light.scaled(self.lamp_scale)

    def patch_picture(self, effects: Sequence[AppliedEffect], lamp_scale: float = 1.0) -> NDArray[np.float64]:
        """Picture by patch transport, over ``lamp_scale``.

        Parameters
        ----------
        effects
            Effects of scene, settings and transport.
        lamp_scale
            Factor on the lamp's power.

        Returns
        -------
        NDArray
            (band, y, x) DN.
        """
        key = (*effects_key(effects), lamp_scale)
        return self._pictures.get(key, lambda: self._mixed_picture(effects, lamp_scale) / lamp_scale)

    def _mixed_picture(self, effects: Sequence[AppliedEffect], lamp_scale: float) -> NDArray[np.float64]:
        """(band, y, x) picture by patch transport, DN; a mixture for lamps between traced patterns.

        Light is linear in the lamps' patterns, so that the same rays serve all mixtures.
        """
        scene = after_stage(self.scene, effects, "scene")
        scene = scene.with_lamps(lambda lamp: replace(lamp, radiance=lamp.radiance.scaled(lamp_scale)))
        return np.asarray(
            sum(share * self.patch_picture_of(traced, effects) for share, traced in _traced_patterns(scene))
        )

    def _faces(self, effects: Sequence[AppliedEffect]) -> NDArray[np.int64]:
        """(y, x) index of the only flat face that a pixel sees, -1 for several."""
        scene = after_stage(self.scene, effects, "scene")

        def face_map() -> NDArray[np.int64]:
            return self._transport(_with_pattern(scene, 1.0, 0.0)).face_alone

        return self._traced.faces.get(_meshes(scene), face_map)

    def patch_picture_of(self, scene: Scene, effects: Sequence[AppliedEffect]) -> NDArray[np.float64]:
        """Picture by patch transport of a changed scene.

        Parameters
        ----------
        scene
            Scene with the effects of the scene stage.
        effects
            Effects; those of settings and transport act here.

        Returns
        -------
        NDArray
            (band, y, x) DN.
        """
        light = self.patch_light_of(scene, effects)
        return (light.weights @ light.lamp)[:, None, None] * light.picture()

    def patch_light_of(self, scene: Scene, effects: Sequence[AppliedEffect]) -> PatchLight:
        """Light by patch transport of a changed scene.

        Parameters
        ----------
        scene
            Scene with the effects of the scene stage.
        effects
            Effects; those of settings and transport act here.

        Returns
        -------
        PatchLight
            Over the lamps' mean in each band.
        """
        settings = after_stage(self.settings, effects, "settings")
        light: PatchLight = patch_light(
            self._transport(scene),
            scene,
            self.effective_nm,
            WAVELENGTH_NM,
            sensor_matrix(self.sensing.curves.responses()),
            scene.lamp_radiance(WAVELENGTH_NM),
            max_bounces=settings.max_bounces,
            samples=self.samples,
        )
        return after_stage(light, effects, "transport")

    def _transport(self, scene: Scene) -> PatchTransport:
        """Exchange of light of a scene, stored by lamps' patterns, and by materials and meshes."""
        patterns = tuple((lamp.edge_ratio, lamp.exponent) for lamp in scene.lamps)
        surfaces = (
            *(lamp.reflects for lamp in scene.lamps),
            *(s.material for s in scene.surfaces),
            *_meshes(scene),
        )
        transports = self._traced.transports
        alike = next((each for (_, other), each in transports.results.items() if other == surfaces), None)
        arguments = (scene, self.camera, self.settings.seed, self.gather_samples, self.patch_samples, alike)
        return transports.get((patterns, surfaces), lambda: coarse_transport(*arguments))


def effects_key(effects: Sequence[AppliedEffect]) -> tuple:
    """Key of effects for stores: identifiers and values in order.

    Parameters
    ----------
    effects
        Effects with their values.

    Returns
    -------
    tuple
        Hashable; equal for equal effects in the same order.
    """
    return tuple((e.id, tuple(e.values.items())) for e in effects)


def _meshes(scene: Scene) -> tuple[bytes, ...]:
    return tuple(s.vertices_mm.tobytes() for s in scene.all_surfaces)


def _with_pattern(scene: Scene, edge_ratio: float, exponent: float) -> Scene:
    return scene.with_lamps(lambda lamp: replace(lamp, edge_ratio=edge_ratio, exponent=exponent))


def _traced_patterns(scene: Scene) -> list[tuple[float, Scene]]:
    """Scenes whose lamps have traced patterns, and the share of each in the light."""
    edge_ratio, exponent = scene.lamp.edge_ratio, scene.lamp.exponent
    if any((lamp.edge_ratio, lamp.exponent) != (edge_ratio, exponent) for lamp in scene.lamps):
        return [(1.0, scene)]
    edges = [(1.0, edge_ratio)]
    if 0.0 < edge_ratio < 1.0:
        even = edge_ratio / (edge_ratio + (1 - edge_ratio) * 4 / 9)
        edges = [(even, 1.0), (1 - even, 0.0)]
    return [
        (of_edge * of_exponent, _with_pattern(scene, edge, traced))
        for of_edge, edge in edges
        for of_exponent, traced in _exponent_shares(exponent)
    ]


def _exponent_shares(exponent: float) -> list[tuple[float, float]]:
    """Shares of traced exponents, by the parabola through three of them."""
    if exponent in _TRACED_EXPONENTS or not _TRACED_EXPONENTS[0] < exponent < _TRACED_EXPONENTS[-1]:
        return [(1.0, exponent)]
    first = min(int(np.searchsorted(_TRACED_EXPONENTS, exponent)) - 1, len(_TRACED_EXPONENTS) - 3)
    traced = _TRACED_EXPONENTS[first : first + 3]
    return [
        (float(np.prod([(exponent - other) / (each - other) for other in traced if other != each])), each)
        for each in traced
    ]


def with_change_of(signal: NDArray, before: NDArray, after: NDArray, face: NDArray | None) -> NDArray[np.float64]:
    """Signal with the change of a picture by patch transport.

    The change is applied as a ratio, in which errors of the coarse patches cancel. Where the ratio is not between 0.5
    and 2 (dark pixels, moved edges), it is applied as a difference.

    Parameters
    ----------
    signal
        (band, y, x) signal of the accurate picture, DN.
    before
        (band, y, x) picture by patch transport before the change, DN.
    after
        (band, y, x) picture by patch transport after the change, DN.
    face
        (y, x) index of the only face that a pixel sees before and after, -1 for several; None if geometry did not move.

    Returns
    -------
    NDArray
        (band, y, x) changed signal, DN.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = after / before
    steady = np.isfinite(ratio) & (ratio > 0.5) & (ratio < 2.0)
    if face is not None:
        ratio = averaged_on_faces(ratio, np.where(steady.all(axis=0), face, -1))
    return np.where(steady, signal * np.where(steady, ratio, 1.0), signal + after - before)


def averaged_on_faces(ratio: NDArray, face: NDArray) -> NDArray[np.float64]:
    """Ratios (band, y, x), smoothed over neighbours on the same face.

    A moved edge blocks rays at random, independently between pixels. For a motion of 1 mm this noise exceeds the change
    itself.

    Parameters
    ----------
    ratio
        (band, y, x) ratios.
    face
        (y, x) index of the only face that a pixel sees; pixels with -1 stay as they are.

    Returns
    -------
    NDArray
        (band, y, x) smoothed ratios.
    """
    result = ratio.copy()
    for index in np.unique(face[face >= 0]):
        rows, columns = np.nonzero(face == index)
        # nothing outside the face counts, so that its rectangle is enough
        around = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
        members = face[around] == index
        weight = gaussian_filter(members.astype(float), _NEIGHBOURS_PX, mode="constant")[members]
        values = np.where(members, ratio[:, *around], 0.0)
        values = gaussian_filter(values, (0, _NEIGHBOURS_PX, _NEIGHBOURS_PX), mode="constant")
        result[:, *around][:, members] = values[:, members] / weight
    return result


def coarse_transport(
    scene: Scene,
    camera: Camera,
    seed: int,
    samples: int = _SAMPLES,
    patch_samples: int = _PATCH_SAMPLES,
    alike: PatchTransport | None = None,
) -> PatchTransport:
    """Exchange of light in coarse patches, for changes of the picture.

    Parameters
    ----------
    scene
        The scene.
    camera
        Camera of the picture.
    seed
        Seed of the rays.
    samples
        Rays of each pixel.
    patch_samples
        Rays from each patch.
    alike
        Exchange of the same surfaces by these rays, under lamps of other patterns, see ``build_patch_transport``.

    Returns
    -------
    PatchTransport
        The exchange between patches, lamps and pixels.
    """
    edge = float(np.linalg.norm(np.ptp(scene.corners_mm, axis=0))) / _PATCHES_PER_DIAGONAL
    return build_patch_transport(build_patched_scene(scene, edge, patch_samples, seed), camera, samples, seed, alike)


def build_predictor(
    light: LightField,
    image: RenderedImage,
    camera: Camera,
    sensing: Sensing,
    scene: Scene,
    settings: RenderSettings,
    included: Sequence[AppliedEffect] = (),
) -> Predictor:
    """Predictor of a base picture that was gathered from ``light`` through ``camera``.

    Parameters
    ----------
    light
        Radiosity solution.
    image
        Base picture, averaged over its batches.
    camera
        Camera of the base picture.
    sensing
        Constants of the sensor equation.
    scene
        Scene without effects.
    settings
        Settings without effects.
    included
        Effects of scene or settings that are in the base picture.

    Returns
    -------
    Predictor
        At the lamp's stated power.
    """
    base = scene_light(image, sensing.curves, camera)
    warp = build_warp(light.tracer, camera, image, base.signal)
    base = with_scene_behind(base, warp)
    return Predictor(scene, sensing, camera, light, image, base, settings, tuple(included), base.effective_nm, warp)
