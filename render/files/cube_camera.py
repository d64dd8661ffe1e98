"""The camera that a cube carries as an attribute, as text in JSON."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.cornell_box import cornell_camera

__all__ = ["camera_attribute", "camera_of_attribute"]


def camera_attribute(camera: Camera) -> str:
    """Text of a camera: its size and ten parameters in the order of ``PARAMETER_NAMES``.

    Parameters
    ----------
    camera
        The camera.

    Returns
    -------
    str
        JSON.
    """
    return json.dumps(
        {"width_px": camera.width_px, "height_px": camera.height_px, "parameters": camera.parameters.tolist()}
    )


def camera_of_attribute(text: object) -> Camera | None:
    """Camera of a cube's attribute.

    Parameters
    ----------
    text
        Value of the attribute; None where it is missing.

    Returns
    -------
    Camera or None
        None where the text states no camera.
    """
    try:
        record = json.loads(text)  # type: ignore[arg-type]
        size = int(record["width_px"]), int(record["height_px"])
        values = np.array(record["parameters"], float)
    except (TypeError, ValueError, KeyError):
        return None
    if values.shape != (10,) or not np.isfinite(values).all():
        return None
    return replace(cornell_camera(size[0]), height_px=size[1]).with_parameters(values)
