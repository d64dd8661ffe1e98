"""Camera files (JSON): one camera with its conventions, for renders and for other programs."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.lens import LENS_TERMS, PLAIN_LENS, Lens
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import validated
from cboxlab.utils.input_files import read_json
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, Strict, model_validator

__all__ = ["camera_entry", "read_camera"]

_CONVENTIONS = (
    "Right-handed world axes, lengths in mm. rotation takes world axes to camera axes (x right, y down, z forward). "
    "A point with camera coordinates (X, Y, Z), x = X / Z, y = Y / Z, appears at u = f (1 + k1 (x^2 + y^2)) x + u0, "
    "v = f (1 + k1 (x^2 + y^2)) y + v0. u runs right, v down, (0, 0) is the centre of the top-left pixel. A pixel's "
    "value is the mean over its square."
)
#: Addition to the conventions of a camera whose lens has more terms than k1.
_LENS_CONVENTIONS = (
    " With lens, OpenCV's formula replaces the factor 1 + k1 (x^2 + y^2): k1, k2, p1, p2, k3 of the pinhole model, or "
    "k1 to k4 of the fisheye model; the vertical focal length is aspect f."
)
#: Largest deviation of R R^T from the unit matrix: 1e-6, a matrix written with seven digits.
_MAX_NON_ORTHOGONALITY = 1e-6
#: Smallest sine of the angle between the direction of view and up: 1e-9, below which rounding sets the picture's roll.
_MIN_SINE_TO_UP = 1e-9

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Three = Annotated[tuple[_Finite, _Finite, _Finite], Strict(False)]


class _LensEntry(BaseModel):
    """Terms of a lens beyond k1, checked."""

    model_config = ConfigDict(extra="forbid", strict=True)

    model: Literal["polynomial", "fisheye"] = "polynomial"
    k2: _Finite = 0.0
    k3: _Finite = 0.0
    k4: _Finite = 0.0
    p1: _Finite = 0.0
    p2: _Finite = 0.0
    aspect: float = Field(default=1.0, gt=0, allow_inf_nan=False)


class _CameraFile(BaseModel):
    """Content of a camera file, checked."""

    model_config = ConfigDict(extra="forbid", strict=True)

    format: Literal["camera/1"]
    conventions: str = ""
    width_px: int = Field(ge=1, le=16384)
    height_px: int = Field(ge=1, le=16384)
    position_mm: _Three
    rotation: Annotated[tuple[_Three, _Three, _Three], Strict(False)] | None = None
    look_at_mm: _Three | None = None
    up: _Three = (0.0, 1.0, 0.0)
    focal_length_px: float = Field(gt=0, allow_inf_nan=False)
    principal_point_px: Annotated[tuple[_Finite, _Finite], Strict(False)] | None = None
    k1: _Finite = 0.0
    lens: _LensEntry | None = None

    @model_validator(mode="after")
    def _terms_of_its_model(self) -> _CameraFile:
        if self.lens is not None:
            allowed = LENS_TERMS[self.lens.model]
            wrong = [t for t in ("k3", "k4", "p1", "p2") if t not in allowed and getattr(self.lens, t) != 0]
            if wrong:
                raise ValueError(f"no {', '.join(wrong)} in a lens of the model '{self.lens.model}'")
        return self


def read_camera(path: Path) -> Camera:
    """Camera of a camera file.

    The direction of view is either ``rotation`` (3 x 3, world to camera axes) or ``look_at_mm``, a point that appears
    at the principal point, with ``up``. A principal point that is left out is the image's centre.

    Parameters
    ----------
    path
        The file, JSON.

    Returns
    -------
    Camera
        The camera.

    Raises
    ------
    InputError
        If the file is missing, is no camera file, or has faulty keys; the message lists every fault.
    """
    path = Path(path)
    content = read_json(path, "a camera file in JSON")
    entry = validated(path, content, _CameraFile)
    position = np.array(entry.position_mm)
    if (entry.rotation is None) == (entry.look_at_mm is None):
        fault = "neither rotation nor look_at_mm" if entry.rotation is None else "rotation and look_at_mm"
        raise InputError(path, fault, "one of rotation and look_at_mm")
    if entry.look_at_mm is not None:
        rotation = _looking(position, np.array(entry.look_at_mm), np.array(entry.up), path)
    else:
        rotation = np.array(entry.rotation)
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > _MAX_NON_ORTHOGONALITY or np.linalg.det(rotation) < 0:
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
        lens=PLAIN_LENS if entry.lens is None else Lens(**entry.lens.model_dump()),
    )


def _looking(position: NDArray, target: NDArray, up: NDArray, path: Path) -> NDArray[np.float64]:
    """(3, 3) rotation, world to camera axes, of a camera that looks at ``target``."""
    forward = target - position
    right = np.cross(forward, up)
    if not np.linalg.norm(right) > _MIN_SINE_TO_UP * np.linalg.norm(forward) * np.linalg.norm(up):
        fault = "a point in the direction of up, or the camera's own position"
        raise InputError(f"{path}: look_at_mm", fault, "a point in another direction than up")
    rows = np.stack([right, np.cross(forward, right), forward])
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def camera_entry(camera: Camera) -> dict[str, Any]:
    """Content of a camera file.

    Parameters
    ----------
    camera
        The camera. Its further distortion, which has no parameters, is not written.

    Returns
    -------
    dict
        The content, ready for JSON.
    """
    entry: dict[str, Any] = {
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
    if not camera.lens.one_term:
        entry |= {"conventions": _CONVENTIONS + _LENS_CONVENTIONS, "lens": asdict(camera.lens)}
    return entry
