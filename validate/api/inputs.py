"""Arguments of the public functions: a path, a name or the object itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cboxlab.calibration.capture import Capture, load_capture
from cboxlab.rendering.model import Model, load_model
from cboxlab.scenes import Scene, load_scene
from cboxlab.utils.arguments import MAX_SEED, described, required_number, required_path, required_whole_number
from cboxlab.utils.errors import InputError

__all__ = ["CaptureLike", "ModelLike", "as_capture", "as_model"]

CaptureLike = Capture | str | Path
ModelLike = Model | Scene | str | Path | None


def as_capture(capture: CaptureLike) -> Capture:
    """Capture of an argument.

    Parameters
    ----------
    capture
        A capture, or its folder.

    Returns
    -------
    Capture
        The checked capture.

    Raises
    ------
    InputError
        If the argument is neither, or the capture is faulty.
    """
    if isinstance(capture, Capture):
        return capture
    if not isinstance(capture, str | Path):
        raise InputError("capture", described(capture), "a capture or its folder")
    return load_capture(required_path("capture", capture, "a capture or its folder"))


def as_model(
    model: ModelLike,
    captures: Sequence[Capture] = (),
    *,
    noise: float | None = None,
    seed: int | None = None,
) -> Model:
    """Model of an argument.

    Parameters
    ----------
    model
        A model, a scene, a model file, a scene file, or the name of a packaged scene. None for the box that the
        captures state, and for the published box where they state none that is available.
    captures
        Captures whose stated box is used.
    noise
        Noise of the rendering, in place of the model's: median over the pixels of the rendering's standard
        deviation over the sensor's.
    seed
        Seed of the rendering, in place of the model's.

    Returns
    -------
    Model
        The model.

    Raises
    ------
    InputError
        If the argument is none of these, a file is faulty, the captures state several boxes, or noise or seed
        is out of its range.
    """
    if model is None:
        result = _model_of(captures)
    elif isinstance(model, Model):
        result = model
    elif isinstance(model, Scene):
        result = Model(model, name=model.name)
    elif isinstance(model, str | Path):
        result = load_model(model)
    else:
        expected = "a Model, a Scene, a model file, a scene file, or the name of a packaged scene"
        raise InputError("model", described(model), expected)
    if noise is not None:
        result = replace(result, render=replace(result.render, noise=required_number("noise", noise, above=0.0)))
    if seed is not None:
        result = replace(result, render=replace(result.render, seed=required_whole_number("seed", seed, 0, MAX_SEED)))
    return result


def _model_of(captures: Sequence[Capture]) -> Model:
    """Model of the scene that the captures state, the published box where they state none."""
    states: dict[str, Capture] = {}
    for capture in captures:
        reference = capture.scene_reference
        if reference is None:
            continue
        if reference.endswith(".toml") and not Path(reference).is_file():
            where = f"{capture.folder / 'capture.toml'}: scene"
            raise InputError(where, f"'{capture.manifest.scene}', which does not exist", "a file of the capture")
        states.setdefault(reference, capture)
    if len(states) > 1:
        (first, capture), (second, other) = list(states.items())[:2]
        where, first_where = (f"{item.folder / 'capture.toml'}: scene" for item in (other, capture))
        raise InputError(where, f"'{second}'", f"'{first}', which {first_where} states: captures of one box")
    published = Model()
    for reference, capture in states.items():
        if published.scene.origin is None or reference != published.scene.origin.reference:
            scene = capture.scene or load_scene(reference)
            return Model(scene, name=scene.name)
    return published
