"""A model and a camera, made ready for other renderers."""

from __future__ import annotations

from pathlib import Path

from cboxlab.rendering.export import Exported, ExportSettings, exported_scene
from cboxlab.rendering.model import Model, model_cube_inputs, view_of
from cboxlab.scenes.cornell_box import cornell_camera
from cboxlab.utils.errors import InputError

__all__ = ["exported_model"]


def exported_model(model: Model, camera: Path | None, size_px: int, settings: ExportSettings) -> Exported:
    """camera : a camera file or a capture folder; None for the published camera of ``size_px`` pixels a side.

    Raises InputError for what cannot be read or exported, effects of light transport among it.
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
