"""Whether two pictures were taken by the same camera: only then do equal pixels show the same points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.scenes.camera import Camera
from cboxlab.utils.frozen import OwnMappings

__all__ = [
    "LARGEST_SHIFT_PX",
    "NOTED_SHIFT_PX",
    "Instrument",
    "instrument_of",
    "shift_px",
]

#: Pictures whose points lie further apart, px, are not compared; from the second number on a note says so.
LARGEST_SHIFT_PX, NOTED_SHIFT_PX = 1.0, 0.1

#: Where cameras are compared: at these distances, mm, and at so many places across and down.
_DISTANCES_MM, _GRID = (800.0, 1400.0), 5

#: Relative differences of an instrument's numbers below this are rounding.
_ROUNDING = 1e-3


@dataclass(frozen=True)
class Instrument(OwnMappings):
    """What a picture was taken with. camera : None where unknown. numbers : of sensor and lens, by name."""

    camera: Camera | None
    numbers: Mapping[str, float]

    def differences(self, other: Instrument) -> list[str]:
        """Sentences on numbers that differ, such as the gain: counts then mean different amounts of light."""
        return [
            f"the cameras differ in {name}: {value:g} and {other.numbers[name]:g}; their counts differ in meaning"
            for name, value in self.numbers.items()
            if name in other.numbers and abs(other.numbers[name] - value) > _ROUNDING * abs(value)
        ]


def instrument_of(capture: Capture, camera: Camera | None) -> Instrument:
    """The camera as calibrated, and what the manifest states of sensor and lens."""
    sensor, lens = capture.manifest.camera, capture.manifest.lens
    stated = {
        "gain, e-/DN": sensor.gain_e_per_dn,
        "pixel pitch, um": sensor.pixel_pitch_um,
        "focal length, mm": lens.focal_length_mm,
    }
    return Instrument(camera, {name: value for name, value in stated.items() if value is not None})


def shift_px(first: Camera, second: Camera) -> float:
    """Largest distance, px, between where two cameras show the same points, over the image of the first."""
    u, v = np.meshgrid(np.linspace(0, first.width_px - 1, _GRID), np.linspace(0, first.height_px - 1, _GRID))
    image = np.stack([u.ravel(), v.ravel()], axis=-1)
    rays = first.directions(*image.T)
    points = np.concatenate([first.position_mm + distance * rays for distance in _DISTANCES_MM])
    apart = np.linalg.norm(second.project(points) - np.tile(image, (len(_DISTANCES_MM), 1)), axis=1)
    return float(np.nanmax(apart)) if np.isfinite(apart).any() else float("inf")
