"""Camera files (JSON): one camera with its conventions, to render from and to hand to other programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import combined, faults_of_validation
from cboxlab.utils.files import replacing
from cboxlab.utils.input_files import read_json
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

__all__ = ["camera_entry", "read_camera", "write_camera"]

_CONVENTIONS = (
    "Right-handed world axes, lengths in mm. rotation takes world axes to camera axes (x right, y down, z forward). "
    "A point with camera coordinates (X, Y, Z), x = X / Z, y = Y / Z, appears at u = f (1 + k1 (x^2 + y^2)) x + u0, "
    "v = f (1 + k1 (x^2 + y^2)) y + v0. u runs right, v down, (0, 0) is the centre of the top-left pixel. A pixel's "
    "value is the mean over its square."
)
#: Largest deviation of R R^T from the unit matrix.
_ORTHOGONAL = 1e-6

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Three = tuple[_Finite, _Finite, _Finite]


class _CameraFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    format: Literal["camera/1"]
    conventions: str = ""
    width_px: int = Field(ge=1, le=16384)
    height_px: int = Field(ge=1, le=16384)
    position_mm: _Three
    rotation: tuple[_Three, _Three, _Three] | None = None
    look_at_mm: _Three | None = None
    up: _Three = (0.0, 1.0, 0.0)
    focal_length_px: float = Field(gt=0, allow_inf_nan=False)
    principal_point_px: tuple[_Finite, _Finite] | None = None
    k1: _Finite = 0.0


def read_camera(path: Path) -> Camera:
    """The camera of a file. Raises InputError naming every fault.

    The direction is either ``rotation`` (3 x 3, world to camera axes) or ``look_at_mm``, a point that appears at the
    principal point, with ``up``; the principal point is the image's centre where it is left out.
    """
    path = Path(path)
    content = read_json(path, "a camera file in JSON")
    try:
        entry = _CameraFile.model_validate(content)
    except ValidationError as error:
        raise combined(faults_of_validation(path, error, _CameraFile)) from None
    position = np.array(entry.position_mm)
    if (entry.rotation is None) == (entry.look_at_mm is None):
        found = "neither rotation nor look_at_mm" if entry.rotation is None else "rotation and look_at_mm"
        raise InputError(path, found, "one of rotation and look_at_mm")
    if entry.look_at_mm is not None:
        rotation = _looking(position, np.array(entry.look_at_mm), np.array(entry.up), path)
    else:
        rotation = np.array(entry.rotation)
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > _ORTHOGONAL or np.linalg.det(rotation) < 0:
            raise InputError(
                f"{path}: rotation", "a matrix that is no rotation", "orthonormal rows of a right-handed turn"
            )
    centre = ((entry.width_px - 1) / 2, (entry.height_px - 1) / 2)
    return Camera(
        entry.width_px,
        entry.height_px,
        entry.focal_length_px,
        np.array(entry.principal_point_px or centre),
        entry.k1,
        rotation,
        position,
    )


def _looking(position: NDArray, target: NDArray, up: NDArray, path: Path) -> NDArray[np.float64]:
    forward = target - position
    right = np.cross(forward, up)
    if not np.linalg.norm(right) > 1e-9 * np.linalg.norm(forward) * np.linalg.norm(up):
        found = "a point in the direction of up, or the camera's own position"
        raise InputError(f"{path}: look_at_mm", found, "a point in another direction than up")
    rows = np.stack([right, np.cross(forward, right), forward])
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def camera_entry(camera: Camera) -> dict[str, Any]:
    """What a camera file holds. The further distortion, which has no parameters, is not in it."""
    return {
        "format": "camera/1",
        "conventions": _CONVENTIONS,
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "position_mm": camera.position_mm.tolist(),
        "rotation": camera.rotation.tolist(),
        "focal_length_px": float(camera.focal_length_px),
        "principal_point_px": camera.principal_point_px.tolist(),
        "k1": float(camera.k1),
    }


def write_camera(path: Path, camera: Camera) -> None:
    """Write a camera file that ``read_camera`` reads back. Raises InputError for a camera with further distortion."""
    if camera.further_distortion is not None:
        raise InputError(path, "a camera with distortion beyond k1", "a camera of ten parameters")
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(camera_entry(camera), indent=1) + "\n", encoding="utf-8")
