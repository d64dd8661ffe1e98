"""A scene's faces divided into patches, and the exchange of light between them, which no spectrum changes."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from cboxlab.scenes.scene import Scene
from cboxlab.utils.errors import InputError

from ..device import mi
from ..visibility import Tracer, build_tracer
from .lamp import LampSampler, build_lamp_samplers
from .patches import Patches, build_patches
from .solution import Exchange, trace_exchange

__all__ = ["PatchedScene", "Places", "build_patched_scene"]

#: Default number of patch edges along the scene's diagonal: patches of about 50 mm in the published box.
PATCHES_PER_DIAGONAL = 20


@dataclass(frozen=True)
class Places:
    """The arguments of ``trace_exchange``, and the patches' edge; equal if only paints and spectra differ."""

    tracer: Tracer = field(compare=False)
    lamps: tuple[LampSampler, ...] = field(compare=False)
    patches: Patches = field(compare=False)
    edge_mm: float
    samples: int
    seed: int
    shape: bytes


def _shape_of(tracer: Tracer, edge_mm: float) -> bytes:
    """All that light exchange between patches depends on: triangles, which of them reflect, the lamps' patterns."""
    lamps, reflecting = tracer.scene.lamps, tracer.material < tracer.reflectors
    emitting = tracer.material - len(tracer.material_names)
    known = mi.variant(), edge_mm, tracer.vertices, tracer.surface, reflecting, np.maximum(emitting, -1)
    return pickle.dumps((known, [(lamp.edge_ratio, lamp.exponent, lamp.pattern) for lamp in lamps]))


@lru_cache(maxsize=2)
def _exchange(places: Places) -> Exchange:
    """Kept for the last boxes: another paint or spectrum needs no new rays between the patches."""
    return trace_exchange(places.tracer, places.lamps, places.patches, places.samples, places.seed)


@dataclass(frozen=True, eq=False)
class PatchedScene:
    """Patches of a scene, and the exchange between lamps and patches. places : what the exchange was traced from."""

    tracer: Tracer
    lamps: tuple[LampSampler, ...]
    patches: Patches
    exchange: Exchange
    places: Places


def build_patched_scene(
    scene: Scene, patch_edge_mm: float | None = None, patch_samples: int = 2048, seed: int = 0
) -> PatchedScene:
    """Divide a scene and trace the exchange. Parameters as in ``render_final_gather``.

    Raises InputError for a scene that is not diffuse.
    """
    if not scene.diffuse:
        found = "surfaces that are not Lambertian or have a texture, or a medium"
        raise InputError(f"scene {scene.name}", found, "a diffuse scene", "The general path tracer takes any scene.")
    tracer = build_tracer(scene)
    lamps = build_lamp_samplers(tracer)
    extent = tracer.vertices.reshape(-1, 3)
    diagonal = float(np.linalg.norm(extent.max(axis=0) - extent.min(axis=0)))
    edge = patch_edge_mm or diagonal / PATCHES_PER_DIAGONAL
    patches = build_patches(tracer, edge)
    places = Places(tracer, lamps, patches, edge, patch_samples, seed ^ 0x5EED, _shape_of(tracer, edge))
    return PatchedScene(tracer, lamps, patches, _exchange(places), places)
