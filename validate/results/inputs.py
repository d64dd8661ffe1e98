"""What the public face takes: a capture or its folder, a model, its file or a packaged scene's name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from cboxlab.calibration.capture import Capture, load_capture

from ..model import Model, load_model

__all__ = ["ModelLike", "as_capture", "as_model", "capture_folder"]

ModelLike = Model | str | Path | None


def as_capture(capture: Capture | str | Path) -> Capture:
    """The capture itself, or that of a folder. Raises InputError."""
    return capture if isinstance(capture, Capture) else load_capture(Path(capture))


def capture_folder(capture: Capture | str | Path) -> Path:
    """Where a capture lies."""
    return capture.folder if isinstance(capture, Capture) else Path(capture)


def as_model(model: ModelLike, *, noise: float | None = None, seed: int | None = None) -> Model:
    """A model, that of a file or of a packaged scene, the published box where None.

    noise, seed : in place of the model's own settings. Raises InputError.
    """
    found = Model() if model is None else model if isinstance(model, Model) else load_model(model)
    if noise is not None:
        found = replace(found, render=replace(found.render, noise=noise))
    return found if seed is None else replace(found, render=replace(found.render, seed=seed))
