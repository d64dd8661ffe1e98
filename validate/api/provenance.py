"""Origin of a spectral cube: model, camera, seed, version of the program, command."""

from __future__ import annotations

from importlib.metadata import version

from cboxlab.rendering.files import camera_attribute
from cboxlab.rendering.model import Model, model_text
from cboxlab.scenes.camera import Camera

__all__ = ["provenance"]


def provenance(model: Model, camera: Camera, seed: int, command: str) -> dict[str, str]:
    """Attributes of a spectral cube that state its origin.

    Parameters
    ----------
    model
        Rendered model.
    camera
        Camera of the picture.
    seed
        Seed of the random numbers.
    command
        Command as typed, or the function's name.

    Returns
    -------
    dict
        Text by name; ``PROVENANCE`` in ``cboxlab.rendering.files`` lists the names.
    """
    return {
        "model": model_text(model),
        "camera": camera_attribute(camera),
        "seed": str(seed),
        "cboxlab_version": version("cboxlab"),
        "command": command,
    }
