"""What an effect is: an identifier, its parameters, where it acts, a pure function, and how to confirm it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from cboxlab.calibration.sensor_equation import BandResponse
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.errors import InputError
from numpy.typing import NDArray

__all__ = ["AppliedEffect", "BandCurves", "Counts", "Effect", "Light", "Parameter", "Stage", "index_of"]

#: Where an effect acts, in the order of the chain from lamp to counts, and what its function changes:
#: scene: Scene. settings: RenderSettings. transport: PatchLight.
#: camera: Camera. filter: BandCurves. optics: Light. counts: Counts.
Stage = Literal["scene", "settings", "transport", "camera", "filter", "optics", "counts"]


@dataclass(frozen=True)
class Parameter:
    """One number, or one name out of ``choices`` (then unit, null and bounds mean nothing).

    null : the value at which the effect does nothing, None for a parameter that has none (a peak's place).
    low, high : bounds of what is physically plausible. step : a small change, for derivatives.
    open : the choices are the published box's; any name that the scene or the capture at hand holds will do.
    """

    name: str
    unit: str = "1"
    null: float | None = None
    low: float = -np.inf
    high: float = np.inf
    step: float = 1e-3
    default: float | None = None
    choices: tuple[str, ...] = ()
    open: bool = False


@dataclass(frozen=True)
class Effect:
    """One physical cause that a model may lack.

    summary : what happens in the real box. apply : pure function (value of the stage, **parameters) -> value.
    confirm : how a laboratory confirms it or rules it out. sources : where the formula is from.
    """

    id: str
    stage: Stage
    summary: str
    parameters: tuple[Parameter, ...]
    apply: Callable[..., Any]
    confirm: str
    sources: tuple[str, ...] = ()

    @property
    def numbers(self) -> tuple[Parameter, ...]:
        """The parameters that are numbers."""
        return tuple(p for p in self.parameters if not p.choices)


def index_of(name: str, known: Iterable[str], key: str) -> int:
    """Where a name stands among those that scene or capture hold; raises InputError (at ``key``) if nowhere."""
    names = list(known)
    if name not in names:
        raise InputError(f"effect {key}", f"'{name}', which is not there", f"one of {', '.join(names)}")
    return names.index(name)


@dataclass(frozen=True, eq=False)
class AppliedEffect:
    """An effect with values for all of its parameters. sigma : standard deviations of those fitted to a capture."""

    effect: Effect
    values: Mapping[str, str | float]
    sigma: Mapping[str, float] = field(default_factory=dict)

    @property
    def id(self) -> str:
        """The effect's identifier."""
        return self.effect.id

    def apply(self, value: Any, *context: Any) -> Any:
        """The stage's value, changed."""
        return self.effect.apply(value, *context, **self.values)


@dataclass(frozen=True, eq=False)
class BandCurves:
    """What the filter stage changes: the band responses, factored, as seen at field angles.

    wavelength_nm : (w,). transmittance : (angle, band, w) of the filters alone, at the sines squared of the
    field angle ``sine_squared`` (angle,), ascending from 0. rest : (band, w) F Q T_lens. factor : (band,) K.
    Effects of this stage act in every frame through the filter, flats and reference too.
    """

    bands: tuple[str, ...]
    wavelength_nm: NDArray[np.float64]
    transmittance: NDArray[np.float64]
    sine_squared: NDArray[np.float64]
    rest: NDArray[np.float64]
    factor: NDArray[np.float64]

    def responses(self, angle: int = 0) -> tuple[BandResponse, ...]:
        """The band responses at one of the field angles."""
        return tuple(
            BandResponse(
                band, self.wavelength_nm, self.rest[i] * self.transmittance[angle, i], float(self.factor[i])
            )
            for i, band in enumerate(self.bands)
        )


@dataclass(frozen=True, eq=False)
class Light:
    """What the optics stage changes: the picture of the scene on the sensor, band by band.

    signal : (band, y, x) DN above dark at a flat of 1, not clipped, the lamp included.
    effective_nm : (band,) mean wavelength of each band's signal. camera : for its principal point and size.
    moved : change (band, y, x) of the signal when another camera takes the place of this one. beyond_pixels : the
    change that Gaussian blurs (band,), px, make of the light less what they make of pixels. None where the scene
    behind the picture is not known.
    """

    signal: NDArray[np.float64]
    effective_nm: NDArray[np.float64]
    camera: Camera
    moved: Callable[[Camera], NDArray[np.float64]] | None = None
    beyond_pixels: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None

    def with_signal(self, signal: NDArray[np.float64]) -> Light:
        """The same with another signal."""
        return replace(self, signal=signal)

    def scaled(self, factor: NDArray[np.float64]) -> Light:
        """The same with ``factor``, (band, 1, 1) or a number, times the light."""
        moved, beyond = self.moved, self.beyond_pixels
        return replace(
            self,
            signal=factor * self.signal,
            moved=None if moved is None else lambda camera: factor * moved(camera),
            beyond_pixels=None if beyond is None else lambda sigma_px: factor * beyond(sigma_px),
        )


@dataclass(frozen=True, eq=False)
class Counts:
    """What the counts stage changes: the expected raw frames, and what is known of their taking.

    scene, flat, reference : (band, y, x) DN, dark and flat field included, not clipped.
    dark_scene, dark_flat, dark_reference : (band,) DN, the dark frames' level at these exposures.
    exposure_scene, exposure_flat, exposure_reference : (band,) s. minutes : (band,) from the first frame's
    beginning to the middle of the band's frames. full_scale : DN.
    """

    bands: tuple[str, ...]
    scene: NDArray[np.float64]
    flat: NDArray[np.float64]
    reference: NDArray[np.float64]
    dark_scene: NDArray[np.float64]
    dark_flat: NDArray[np.float64]
    dark_reference: NDArray[np.float64]
    exposure_scene: NDArray[np.float64]
    exposure_flat: NDArray[np.float64]
    exposure_reference: NDArray[np.float64]
    minutes: NDArray[np.float64]
    full_scale: float
