"""Export of a model and a camera for other renderers."""

from __future__ import annotations

from pathlib import Path

from cboxlab.rendering.export import Exported, ExportSettings, exported_scene
from cboxlab.rendering.model import Model, model_cube_inputs, view_of
from cboxlab.scenes.cornell_box import cornell_camera
from cboxlab.utils.errors import InputError

__all__ = ["exported_model"]


def exported_model(model: Model, camera: Path | None, size_px: int, settings: ExportSettings) -> Exported:
    """Export of a model's scene with its effects on scene, camera and settings.

    Parameters
    ----------
    model
        The model.
    camera
        A camera file or a capture folder; None for the published camera.
    size_px
        Pixels a side of the published camera; not used with another one.
    settings
        Wavelengths and sampling.

    Returns
    -------
    Exported
        The export.

    Raises
    ------
    InputError
        If the camera cannot be read, or the scene cannot be exported. A model with an effect on light transport is
        refused, since other renderers lack it.
    """
    for effect in model.effects:
        if effect.stage == "transport":
            raise InputError(
                f"effect {effect.id}",
                "an effect on how light is reflected or scattered",
                "effects on scene, camera or settings, which other renderers have too",
                "Leave it out of the model; a spectral cube of ours can hold it.",
            )
    view, lamp = view_of(cornell_camera(size_px) if camera is None else camera)
    scene, view, bounces = model_cube_inputs(model, view, lamp)
    return exported_scene(scene, view, settings, bounces)
