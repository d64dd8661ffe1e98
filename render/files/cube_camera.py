"""The camera that a cube carries as an attribute, as text in JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.cornell_box import cornell_camera
from cboxlab.scenes.lens import Lens

__all__ = ["camera_attribute", "camera_of_attribute"]


def camera_attribute(camera: Camera) -> str:
    """Text of a camera.

    It holds the size, ten parameters in the order of ``PARAMETER_NAMES``, and the lens's further terms.

    Parameters
    ----------
    camera
        The camera.

    Returns
    -------
    str
        JSON.
    """
    record = {"width_px": camera.width_px, "height_px": camera.height_px, "parameters": camera.parameters.tolist()}
    return json.dumps(record if camera.lens.one_term else record | {"lens": asdict(camera.lens)})


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
        lens = Lens(**record.get("lens", {}))
    except (TypeError, ValueError, KeyError):
        return None
    if values.shape != (10,) or not np.isfinite(values).all():
        return None
    return replace(cornell_camera(size[0]), height_px=size[1], lens=lens).with_parameters(values)
