"""Lens distortion: radial distortion beyond the calibrated model.

k1' = k1 + dk1 in r' = r (1 + k1 r^2), r the tangent of the field angle. The points were surveyed before. The cause is
another focus or zoom setting than at calibration.

Parameters: k1, the change dk1, without unit, null value 0.
Sources: Tsai 1987, A versatile camera calibration technique; OpenCV's first radial term.
"""

from __future__ import annotations

from dataclasses import replace

from cboxlab.scenes.camera import Camera

from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _apply(camera: Camera, k1: float) -> Camera:
    return replace(camera, k1=camera.k1 + k1)


EFFECT = Effect(
    id="lens-distortion",
    stage="camera",
    title="distortion beyond the calibrated camera's",
    summary="The lens distorts more or less than the calibrated model: k1 is added to the camera's. The camera was "
    "calibrated before the change.",
    parameters=(Parameter("k1", "1", null=0.0, low=-0.3, high=0.3, step=1e-3),),
    apply=_apply,
    confirm="Photograph a straight edge near the border, or a chessboard over the whole field, at the "
    "capture's focus setting.",
    sources=("Tsai 1987, A versatile camera calibration technique; OpenCV's first radial term",),
)
