"""The published Cornell Box and the camera published with it."""

from __future__ import annotations

import json

import numpy as np

from .camera import REFERENCE_ROTATION, Camera
from .scene import Scene
from .scene_file import PACKAGED, load_scene

__all__ = ["cornell_box", "cornell_camera"]


def cornell_box() -> Scene:
    """The box as measured at Cornell (source: scenes/data/README.md). The lamp's spectrum is relative."""
    return load_scene("cornell-box")


def cornell_camera(size_px: int) -> Camera:
    """The published camera with size_px x size_px square pixels: a centred pinhole without distortion.

    Film 25 mm wide at 35 mm from the pinhole: the full field is 39.31 degrees (a lens focused at infinity).
    """
    published = json.loads((PACKAGED / "cornell-box-camera.json").read_text())
    return Camera(
        width_px=size_px,
        height_px=size_px,
        focal_length_px=published["focal_length_m"] / published["width_m"] * size_px,
        principal_point_px=np.full(2, (size_px - 1) / 2),
        k1=0.0,
        rotation=REFERENCE_ROTATION.copy(),
        position_mm=np.array(published["position_mm"], float),
    )
