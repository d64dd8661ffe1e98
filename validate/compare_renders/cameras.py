"""Cameras of two pictures: only with equal cameras do equal pixels show the same points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.scenes.camera import Camera
from cboxlab.utils.frozen import FrozenMappings

__all__ = [
    "LARGEST_SHIFT_PX",
    "NOTED_SHIFT_PX",
    "Instrument",
    "instrument_of",
    "shift_px",
]

#: Largest shift between equal pixels of pictures that are compared, px: one pixel.
LARGEST_SHIFT_PX = 1.0
#: Shift from which on a note says so, px: a tenth shows at edges.
NOTED_SHIFT_PX = 0.1
#: Distances at which cameras are compared, mm: front and back of the published box.
_DISTANCES_MM = (800.0, 1400.0)
#: Points across and down at which cameras are compared; distortion is largest at the corners, which are among them.
_GRID_POINTS = 5
#: Largest relative difference of an instrument's numbers that is rounding in manifests.
_ROUNDING = 1e-3


@dataclass(frozen=True)
class Instrument(FrozenMappings):
    """Camera and numbers of sensor and lens of a picture."""

    #: Camera; None where unknown.
    camera: Camera | None
    #: Numbers of sensor and lens by name with unit.
    numbers: Mapping[str, float]

    def differences(self, other: Instrument) -> list[str]:
        """Sentences on numbers that differ, such as the gain.

        Counts then mean different amounts of light.

        Parameters
        ----------
        other
            Instrument of the other picture.

        Returns
        -------
        list of str
            A sentence for each number that both state and that differs.
        """
        return [
            f"the cameras differ in {name}: {value:g} and {other.numbers[name]:g}; their counts differ in meaning"
            for name, value in self.numbers.items()
            if name in other.numbers and abs(other.numbers[name] - value) > _ROUNDING * abs(value)
        ]


def instrument_of(capture: Capture, camera: Camera | None) -> Instrument:
    """Instrument of a capture.

    Parameters
    ----------
    capture
        The capture, whose manifest states sensor and lens.
    camera
        Its calibrated camera; None where unknown.

    Returns
    -------
    Instrument
        Camera and the numbers that the manifest states.
    """
    sensor, lens = capture.manifest.camera, capture.manifest.lens
    numbers = {
        "gain, e-/DN": sensor.gain_e_per_dn,
        "pixel pitch, um": sensor.pixel_pitch_um,
        "focal length, mm": lens.focal_length_mm,
    }
    return Instrument(camera, {name: value for name, value in numbers.items() if value is not None})


def shift_px(first: Camera, second: Camera) -> float:
    """Largest distance between the images of the same points in two cameras.

    Parameters
    ----------
    first
        Camera whose image is covered with a grid of points.
    second
        The other camera.

    Returns
    -------
    float
        Distance, px; infinite where the second camera sees none of the points.
    """
    u, v = np.meshgrid(
        np.linspace(0, first.width_px - 1, _GRID_POINTS), np.linspace(0, first.height_px - 1, _GRID_POINTS)
    )
    image = np.stack([u.ravel(), v.ravel()], axis=-1)
    rays = first.directions(*image.T)
    points = np.concatenate([first.position_mm + distance * rays for distance in _DISTANCES_MM])
    apart = np.linalg.norm(second.project(points) - np.tile(image, (len(_DISTANCES_MM), 1)), axis=1)
    return float(np.nanmax(apart)) if np.isfinite(apart).any() else float("inf")
