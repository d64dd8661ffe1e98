"""Patch transport of random numbers for three patches, five fragments and six pixels: light without any tracing."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
from cboxlab.rendering.perturbation import PatchLight, patch_light
from cboxlab.rendering.perturbation.patch_transport import PatchTransport
from cboxlab.rendering.radiosity.solution import Exchange
from cboxlab.scenes import Scene, Spectrum, cornell_box, cornell_camera
from scipy.sparse import csr_array

#: Of the bands; a lamp whose spectrum is a slope lights the box.
NM = np.array([480.0, 560.0, 640.0])
GRID = np.arange(400.0, 701.0)
#: Surfaces of the published box that the three patches are parts of.
SURFACES = ("floor", "left", "right")


class _Patches(SimpleNamespace):
    def __len__(self):
        return len(self.material)


@dataclass(frozen=True)
class _Field:
    patches: _Patches
    exchange: Exchange
    lamps: tuple[SimpleNamespace, ...]
    tracer: SimpleNamespace


def fake_scene() -> Scene:
    return cornell_box().with_lamp(Spectrum(np.array([300.0, 900.0]), np.array([0.2, 2.0])))


def fake_patch_light(max_bounces: int | None = None) -> PatchLight:
    """No light leaves or enters but by the numbers here; patch k is the k-th of SURFACES, fragments 0 to 4 are on 0, 1,
    2, 0, 1."""
    random, scene = np.random.default_rng(7), fake_scene()
    surfaces = [s.name for s in scene.surfaces]
    values = np.array([surfaces.index(name) for name in SURFACES])
    materials = np.array([list(scene.materials).index(scene.surfaces[i].material) for i in values])
    factors = random.uniform(0.1, 0.4, (3, 3))
    low, high = (np.array([f(scene.surfaces[i].vertices_mm, axis=0) for i in values]) for f in (np.min, np.max))
    face = np.array([0, 1, 2, 0, 1])
    light = _Field(
        patches=_Patches(
            material=materials,
            surface=values,
            centre=low + random.uniform(0.2, 0.8, (3, 3)) * (high - low),
            normal=np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]),
            area=np.array([2e5, 1e5, 3e5]),
            facet=np.arange(3),
        ),
        exchange=Exchange(
            random.uniform(0.1, 0.3, (3, 1)).astype(np.float32),
            factors.astype(np.float32),
            (1 - factors.sum(axis=1)).clip(0).astype(np.float32) + np.float32(0.05),
            None,
            np.ones(3, np.float32),
        ),
        lamps=(SimpleNamespace(centre=np.array([278.0, 548.0, 279.5])),),
        tracer=SimpleNamespace(facet=np.arange(3), facet_surface=values, material=materials),
    )
    camera = replace(cornell_camera(2), height_px=3)
    transport = PatchTransport(
        light,
        camera,
        pixel=np.array([0, 1, 2, 3, 3]),
        face=face,
        coverage=np.array([1.0, 0.5, 1.0, 0.3, 0.6]),
        position=low[face] + random.uniform(0.1, 0.9, (5, 3)) * (high - low)[face],
        direct=random.uniform(0.1, 0.3, (5, 1)).astype(np.float32),
        gather=csr_array(random.uniform(0.0, 0.4, (5, 3)).astype(np.float32)),
        escape=random.uniform(0.0, 0.2, 5).astype(np.float32),
        covered=np.array([1.0, 0.5, 1.0, 0.9, 0.7, 0.0]).reshape(camera.height_px, camera.width_px),
        lamp_coverage=np.zeros((1, camera.height_px, camera.width_px), np.float32),
        lamp_radiance=np.array([0.0, 0.0, 0.0, 0.0, 0.7, 0.0]).reshape(1, camera.height_px, camera.width_px),
    )
    at_each = (GRID == NM[:, None]).astype(float)
    return patch_light(transport, scene, NM, GRID, at_each, scene.lamp.radiance.at(GRID), max_bounces=max_bounces)
