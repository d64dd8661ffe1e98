"""One value of every stage at which an effect acts: input for tests of the effects."""

from typing import Any

import numpy as np
from cboxlab.rendering.chain.band_curves import BandCurves
from cboxlab.rendering.chain.counts import Counts
from cboxlab.rendering.chain.light import Light
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.rendering.effects import Effect, apply_checked
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.scenes.wavelength_grid import FILTER_GRID

BANDS = ("f400", "f550", "f700")
NM = FILTER_GRID.nm


def light(size=(40, 48)) -> Light:
    """A random scene with a lamp fifty times as bright as the rest."""
    signal = 500 * (1 + np.random.default_rng(0).random((3, *size)))
    signal[:, 10:14, 20:26] = 50_000.0
    return Light(signal, np.array([412.0, 550.0, 690.0]), cornell_camera(48))


def counts() -> Counts:
    generator = np.random.default_rng(1)
    scene, flat, reference = (100 + 2000 * generator.random((3, 20, 24)) for _ in range(3))
    dark = np.array([100.0, 101.0, 102.0])
    seconds = np.array([4.0, 2.0, 1.0])
    return Counts(
        BANDS,
        scene,
        flat,
        reference,
        dark,
        dark + 1,
        dark + 2,
        seconds,
        seconds / 2,
        seconds / 4,
        np.array([0.5, 2.0, 5.0]),
        4095.0,
    )


def curves() -> BandCurves:
    bells = np.exp(-0.5 * ((NM - np.array([[400.0], [550.0], [700.0]])) / 15) ** 2)
    return BandCurves(
        BANDS,
        FILTER_GRID,
        np.tile(bells, (4, 1, 1)),
        np.linspace(0, 0.2, 4),
        np.ones((3, NM.size)),
        np.ones(3),
    )


def start(effect: Effect) -> Any:
    """A value of the effect's stage."""
    kinds = {
        "scene": cornell_box,
        "settings": lambda: RenderSettings(max_bounces=3),
        "filter": curves,
        "camera": lambda: cornell_camera(64),
        "optics": light,
        "counts": counts,
    }
    return kinds[effect.stage]()


def apply(identifier: str, value: Any, **values: Any) -> Any:
    """The value changed by an effect of checked parameters; those left out are null."""
    return apply_checked(identifier, values, "test").apply(value)
