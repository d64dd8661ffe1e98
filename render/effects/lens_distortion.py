"""Lens distortion: radial distortion beyond the calibrated model."""

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
    summary="Radial distortion beyond the calibrated model: added to the camera's k1, the points having been "
    "surveyed before.",
    parameters=(Parameter("k1", "1", null=0.0, low=-0.3, high=0.3, step=1e-3),),
    apply=_apply,
    confirm="Photograph a straight edge near the border, or a chessboard over the whole field, at the "
    "capture's focus setting.",
    sources=("Tsai 1987, A versatile camera calibration technique; OpenCV's first radial term",),
)
