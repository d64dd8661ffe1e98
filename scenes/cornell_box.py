"""The published Cornell Box and the camera published with it."""

from __future__ import annotations

import json

import numpy as np

from .camera import REFERENCE_ROTATION, Camera
from .scene import Scene
from .scene_file import PACKAGED, load_scene

__all__ = ["cornell_box", "cornell_camera"]


def cornell_box() -> Scene:
    """Cornell Box as measured at Cornell University (source: scenes/data/README.md).

    Returns
    -------
    Scene
        The packaged scene "cornell-box". Its lamp's spectrum is relative.
    """
    return load_scene("cornell-box")


def cornell_camera(size_px: int) -> Camera:
    """Published camera of the Cornell Box: a centred pinhole without distortion.

    Its film is 25 mm wide, 35 mm from the pinhole. The full field is 39.31 degrees (a lens focused at infinity).

    Parameters
    ----------
    size_px
        Width and height of the image, px.

    Returns
    -------
    Camera
        The camera, with square pixels.
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
