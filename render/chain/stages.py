"""The stages of the chain from the lamp to the counts, in their order.

Everything that follows light through the chain walks this list: the prediction of a capture, the synthetic capture,
a model's spectral cube, the catalogue of effects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, Protocol, TypeVar

from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene

from ..perturbation import PatchLight
from .band_curves import BandCurves
from .counts import Counts
from .light import Light
from .settings import RenderSettings

__all__ = ["PHOTOGRAPHED", "STAGES", "STAGE_TITLES", "ActsAtStage", "Stage", "after_stage", "stages_between"]

Stage = Literal["scene", "settings", "transport", "camera", "filter", "optics", "counts"]

#: In the order of the chain, the type of each stage's value: what an effect of that stage takes and returns.
STAGES: Mapping[Stage, type] = MappingProxyType(
    {
        "scene": Scene,
        "settings": RenderSettings,
        "transport": PatchLight,
        "camera": Camera,
        "filter": BandCurves,
        "optics": Light,
        "counts": Counts,
    }
)

#: What each stage holds, in words, for lists.
STAGE_TITLES: Mapping[Stage, str] = MappingProxyType(
    {
        "scene": "geometry, paints, lamp",
        "settings": "how far the renderer follows light",
        "transport": "what lights the picture",
        "camera": "where it stands, how it distorts",
        "filter": "what the bands pass",
        "optics": "the picture on the sensor",
        "counts": "the raw frames",
    }
)

#: Stages of what is photographed, and not of how a model of it is rendered.
PHOTOGRAPHED: tuple[Stage, ...] = tuple(stage for stage in STAGES if stage != "settings")

Value = TypeVar("Value")


class ActsAtStage(Protocol):
    """An effect with values for all of its parameters."""

    @property
    def stage(self) -> Stage:
        """Stage of the chain at which it acts."""

    def apply(self, value: Any, /) -> Any:
        """Changed value of the stage.

        Parameters
        ----------
        value
            Value of the stage, of the type in STAGES.

        Returns
        -------
        Any
            Value of the same type.
        """


def after_stage(value: Value, effects: Sequence[ActsAtStage], stage: Stage) -> Value:
    """Value of a stage after all effects of that stage, in their order.

    Parameters
    ----------
    value
        Value of the stage before them.
    effects
        Effects of any stage.
    stage
        The stage.

    Returns
    -------
    Value
        The same value where no effect is of the stage.
    """
    for effect in effects:
        if effect.stage == stage:
            value = effect.apply(value)
    return value


def stages_between(first: Stage, last: Stage) -> tuple[Stage, ...]:
    """Stages between two, both included.

    Parameters
    ----------
    first, last
        Stages in the order of the chain.

    Returns
    -------
    tuple of str
        Stages in the order of the chain.
    """
    order = tuple(STAGES)
    return order[order.index(first) : order.index(last) + 1]
