"""Camera pose: the camera moved after its calibration.

R' = Rod(r) R and C' = C + t. R is the rotation from world to camera axes, C the centre of projection in the scene's
axes. Rod is Rodrigues' formula of the rotation vector r, along the camera's right, down and forward axes. The cause is
a push against the tripod between the survey and the scene.

Parameters: rx_deg, ry_deg, rz_deg, degrees, null value 0; tx_mm, ty_mm, tz_mm, mm, null value 0.
Sources: Rodrigues' formula; OpenCV's convention of world to camera.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.scenes.camera import Camera
from scipy.spatial.transform import Rotation

from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _apply(
    camera: Camera, rx_deg: float, ry_deg: float, rz_deg: float, tx_mm: float, ty_mm: float, tz_mm: float
) -> Camera:
    turn = Rotation.from_rotvec([rx_deg, ry_deg, rz_deg], degrees=True).as_matrix()
    position = camera.position_mm + np.array([tx_mm, ty_mm, tz_mm])
    return replace(camera, rotation=turn @ camera.rotation, position_mm=position)


EFFECT = Effect(
    id="camera-pose",
    stage="camera",
    title="the camera moved after its calibration",
    summary="The camera moved after its calibration: R_new = Rod(r) R with R world to camera (r along right, "
    "down, forward). Its centre shifts by t in the scene's axes.",
    parameters=(
        *(Parameter(f"r{axis}_deg", "deg", null=0.0, low=-5.0, high=5.0, step=0.02) for axis in "xyz"),
        *(Parameter(f"t{axis}_mm", "mm", null=0.0, low=-50.0, high=50.0, step=0.5) for axis in "xyz"),
    ),
    apply=_apply,
    own_to_capture=True,
    confirm="Photograph the surveyed points again: the new images fit another camera than the old ones. "
    "Edges in the photograph and surveyed points disagree in the same way in all bands.",
    sources=("Rodrigues' formula; OpenCV's convention of world to camera",),
)
