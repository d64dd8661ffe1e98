"""What a file of results says of its origin: the model, the camera, the seed, the program's version, the command."""

from __future__ import annotations

import json
from importlib.metadata import version

from cboxlab.scenes.camera import Camera

from ..model import Model, model_text

__all__ = ["provenance"]


def provenance(model: Model, camera: Camera, seed: int, command: str) -> dict[str, str]:
    """Attributes of a spectral cube, all of them text: ``PROVENANCE`` in ``render.files`` lists their names.

    camera : size and the ten parameters in the order of ``PARAMETER_NAMES``, as JSON. command : as typed.
    """
    seen = {
        "width_px": camera.width_px, "height_px": camera.height_px, "parameters": camera.parameters.tolist(),
    }  # fmt: skip
    return {
        "model": model_text(model), "camera": json.dumps(seen), "seed": str(seed),
        "cboxlab_version": version("cboxlab"), "command": command,
    }  # fmt: skip
