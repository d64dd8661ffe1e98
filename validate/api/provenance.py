"""What a file of results says of its origin: the model, the camera, the seed, the program's version, the command."""

from __future__ import annotations

from importlib.metadata import version

from cboxlab.rendering.files import camera_attribute
from cboxlab.rendering.model import Model, model_text
from cboxlab.scenes.camera import Camera

__all__ = ["provenance"]


def provenance(model: Model, camera: Camera, seed: int, command: str) -> dict[str, str]:
    """Attributes of a spectral cube, all of them text: ``PROVENANCE`` in ``render.files`` lists their names.

    command : as typed.
    """
    return {
        "model": model_text(model),
        "camera": camera_attribute(camera),
        "seed": str(seed),
        "cboxlab_version": version("cboxlab"),
        "command": command,
    }
