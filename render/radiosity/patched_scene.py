"""A scene divided into patches, and the exchange of light between them.

The exchange depends on no reflectance and no spectrum.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from cboxlab.scenes.scene import Scene

from ..device import mi
from ..visibility import Tracer, build_tracer
from .lamp import LampSampler, build_lamp_samplers
from .patches import Patches, build_patches
from .solution import Exchange, trace_exchange

__all__ = ["ExchangeInputs", "PatchedScene", "build_patched_scene"]

#: Default number of patch edges along the scene's diagonal: patches of about 50 mm in the published box.
PATCHES_PER_DIAGONAL = 20


@dataclass(frozen=True)
class ExchangeInputs:
    """Arguments of `trace_exchange`; equal if only reflectances and spectra differ."""

    #: Tracer of the scene; not compared.
    tracer: Tracer = field(compare=False)
    #: Samplers of its lamps; not compared.
    lamps: tuple[LampSampler, ...] = field(compare=False)
    #: Its patches; not compared.
    patches: Patches = field(compare=False)
    #: Largest edge of a patch, mm.
    edge_mm: float
    #: Rays and lamp samples of a patch.
    samples: int
    #: Seed of the rays.
    seed: int
    #: Everything on which the exchange depends, see `_shape_of`.
    shape: bytes


def _shape_of(tracer: Tracer, edge_mm: float) -> bytes:
    """Everything on which the light exchange depends, pickled.

    These are the triangles, which of them reflect, and the lamps' patterns.
    """
    lamps, reflecting = tracer.scene.lamps, tracer.material < tracer.reflectors
    emitting = tracer.material - len(tracer.material_names)
    geometry = mi.variant(), edge_mm, tracer.vertices, tracer.surface, reflecting, np.maximum(emitting, -1)
    return pickle.dumps((geometry, [(lamp.edge_ratio, lamp.exponent, lamp.pattern) for lamp in lamps]))


@lru_cache(maxsize=2)
def _exchange(inputs: ExchangeInputs) -> Exchange:
    """Exchange of the last two scenes: other paints or spectra need no new rays."""
    return trace_exchange(inputs.tracer, inputs.lamps, inputs.patches, inputs.samples, inputs.seed)


@dataclass(frozen=True, eq=False)
class PatchedScene:
    """Patches of a scene, and the exchange between lamps and patches."""

    #: Tracer of the scene.
    tracer: Tracer
    #: Samplers of its lamps.
    lamps: tuple[LampSampler, ...]
    #: Its patches.
    patches: Patches
    #: Exchange of light between lamps and patches.
    exchange: Exchange
    #: Arguments from which the exchange was traced.
    inputs: ExchangeInputs


def build_patched_scene(
    scene: Scene, patch_edge_mm: float | None = None, patch_samples: int = 2048, seed: int = 0
) -> PatchedScene:
    """Divide a scene into patches and trace the exchange.

    Parameters
    ----------
    scene
        A diffuse scene.
    patch_edge_mm
        Largest edge of a patch, mm; None for a twentieth of the scene's diagonal.
    patch_samples
        Rays, and samples of each lamp, of a patch.
    seed
        Seed of the rays.

    Returns
    -------
    PatchedScene
        Patches and exchange.

    Raises
    ------
    InputError
        For a scene that is not diffuse.
    """
    scene.require_diffuse("The general path tracer takes any scene.")
    tracer = build_tracer(scene)
    lamps = build_lamp_samplers(tracer)
    extent = tracer.vertices.reshape(-1, 3)
    diagonal = float(np.linalg.norm(extent.max(axis=0) - extent.min(axis=0)))
    edge = patch_edge_mm or diagonal / PATCHES_PER_DIAGONAL
    patches = build_patches(tracer, edge)
    inputs = ExchangeInputs(tracer, lamps, patches, edge, patch_samples, seed ^ 0x5EED, _shape_of(tracer, edge))
    return PatchedScene(tracer, lamps, patches, _exchange(inputs), inputs)
