"""What the public face takes: a capture or its folder, a model, its file or a packaged scene's name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cboxlab.calibration.capture import Capture, load_capture
from cboxlab.rendering.model import Model, load_model
from cboxlab.scenes.scene_file import load_scene
from cboxlab.utils.errors import InputError

__all__ = ["ModelLike", "as_capture", "as_model", "capture_folder"]

ModelLike = Model | str | Path | None


def as_capture(capture: Capture | str | Path) -> Capture:
    """The capture itself, or that of a folder. Raises InputError."""
    return capture if isinstance(capture, Capture) else load_capture(Path(capture))


def capture_folder(capture: Capture | str | Path) -> Path:
    """Where a capture lies."""
    return capture.folder if isinstance(capture, Capture) else Path(capture)


def as_model(
    model: ModelLike,
    captures: Sequence[Capture | str | Path] = (),
    *,
    noise: float | None = None,
    seed: int | None = None,
) -> Model:
    """A model, that of a file or of a packaged scene; where None the box that the captures state, or the published
    one where they state none that is a packaged scene or a file.

    noise, seed : in place of the model's own settings. Raises InputError, also for captures that state several boxes.
    """
    if model is None:
        found = _stated(captures)
    else:
        found = model if isinstance(model, Model) else load_model(model)
    if noise is not None:
        found = replace(found, render=replace(found.render, noise=noise))
    return found if seed is None else replace(found, render=replace(found.render, seed=seed))


def _stated(captures: Sequence[Capture | str | Path]) -> Model:
    stated: dict[str, str] = {}
    for capture in map(as_capture, captures):
        scene = capture.scene
        place = f"{capture.folder / 'capture.toml'}: scene"
        if scene is None:
            continue
        if scene.endswith(".toml") and not Path(scene).is_file():
            raise InputError(place, f"'{capture.manifest.scene}', which does not exist", "a file of the capture")
        stated.setdefault(scene, place)
    if len(stated) > 1:
        (first, place), (other, where) = list(stated.items())[:2]
        raise InputError(where, f"'{other}'", f"'{first}', which {place} states: captures of one box")
    scene = next(iter(stated), Model().scene)
    return Model() if scene == Model().scene else Model(scene, name=load_scene(scene).name)
