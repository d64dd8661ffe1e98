"""Regression of the command line's arguments: cubes read, models rendered, scene recognised."""

from __future__ import annotations

import logging
import shlex
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from cboxlab.rendering.files import AS_STATED, Declared, DeclaredPair, Window, files_of
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene_file import packaged_scenes
from cboxlab.utils.arguments import require_type, required_number, required_path
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import temporary_folder
from cboxlab.utils.progress import NO_PROGRESS, Progress

from ..scene_pictures import cube_paths
from .outcome import UNKNOWN, NamedChange, Outcome, as_percent, change_text
from .sides import Side, cut_camera, in_common_quantity, on_common_pixels, read_side, side_of, sound_side
from .verdict import FALSE_ALARMS, regress_sides

if TYPE_CHECKING:
    from cboxlab.scenes.scene import Scene
    from cboxlab.scenes.spectra import Spectrum

    from .variants import Variants

__all__ = ["SIDES", "assert_same_light", "input_files", "regress_inputs", "regress_pictures"]

_log = logging.getLogger(__name__)

#: Largest deviation from the rendering of a scene (see ``mismatch``) of a picture that shows it.
_MAX_MISMATCH = 0.05
#: Names of the sides, where something is declared for one of them.
SIDES = ("baseline", "candidate")
#: Place in a command for the path that it writes to.
_OUT = "{out}"
#: Characters of a failed command's last message that are repeated: about five lines of a terminal.
_MAX_MESSAGE_LENGTH = 400
#: Fewest cubes of a side whose differences have a scatter.
_FEWEST_PAIRS = 2
#: Pixels a side of models, where both sides are models.
_SIZE_PX = 128
#: Wavelengths of models, nm, where both sides are models.
_WAVELENGTHS_NM = np.arange(400.0, 701.0, 20.0)
#: Samples per pixel and batch of models.
_SAMPLES = 64
#: Deciding pools listed in the error of ``assert_same_light``.
_MAX_LISTED_POOLS = 5
#: Explanations listed in the same error.
_MAX_LISTED_CHANGES = 3
#: Probability of wrong labels of wavelengths where the pictures, plane by plane, are the same.
_MISLABELLED_PROBABILITY = 0.99


@dataclass(frozen=True, eq=False)
class View:
    """Scene that both sides show."""

    #: The scene.
    scene: Scene
    #: The camera.
    camera: Camera
    #: Whether the user stated the scene; otherwise the pictures have to match it.
    scene_stated: bool


def regress_inputs(
    baseline: str,
    candidate: str,
    model: str | None = None,
    camera: Path | None = None,
    false_alarms: float = FALSE_ALARMS,
    progress: Progress = NO_PROGRESS,
    *,
    declared: Declared | DeclaredPair = AS_STATED,
    same_seeds: bool = False,
) -> Outcome:
    """Compare the pictures that two arguments name, and name the change where they differ.

    Each argument is one of these: a spectral cube, several joined by commas, a folder of cubes; a command that writes
    one or more, such as "ourrenderer box.xml -o {out}.exr", run by the shell; a model file or a packaged scene.
    Models are rendered at the size and wavelengths of the other side.

    Parameters
    ----------
    baseline, candidate
        The arguments.
    model
        Model of the scene that the cubes show. None stands for a model among the arguments, or else for the published
        box, if the baseline shows it.
    camera
        Camera file or capture folder. None stands for the camera that a cube states, or else for the published one.
    false_alarms
        Rate of false alarms of the verdict.
    progress
        Receiver of the finished part.
    declared
        Properties that the files do not state, of both or of each.
    same_seeds
        Whether both sides are several cubes of the same seeds in the same order.

    Returns
    -------
    Outcome
        Verdict, tests, named change.

    Raises
    ------
    InputError
        If an argument cannot be read or rendered, or if the pictures cannot be compared.
    """
    pair = declared if isinstance(declared, DeclaredPair) else DeclaredPair(SIDES, declared)
    sides = [
        None if _is_model(text) else _read(text, pair.of(index)) for index, text in enumerate((baseline, candidate))
    ]
    used = [() if side is None else side.declared for side in sides]
    instead = [{} if side is None else side.file_statements for side in sides]
    pair.require_used((used[0], used[1]), (instead[0], instead[1]))
    cube = next((side for side in sides if side is not None), None)
    view_camera = camera or next((side.camera for side in sides if side is not None and side.camera), None)
    scene = model or next((text for text in (baseline, candidate) if _is_model(text)), None)
    size = _SIZE_PX if cube is None else _picture_size(cube)
    view = None if scene is None else _view(scene, view_camera, size)
    if view is None and camera is not None:
        view = _published_view(camera, size)
    grid = _WAVELENGTHS_NM if cube is None or cube.in_colour else cube.wavelength_nm
    ready = [
        _rendered(text, view_camera, size, grid, seed) if side is None else side
        for seed, (text, side) in enumerate(zip((baseline, candidate), sides, strict=True))
    ]
    if same_seeds:
        ready = [replace(side, same_seeds=True) for side in ready]
        _require_pairs(ready[0], ready[1])
    return regress_pictures(ready[0], ready[1], view, false_alarms, progress)


def _require_pairs(baseline: Side, candidate: Side) -> None:
    """Raise InputError unless both sides have as many cubes."""
    counts = [1 if side.batches is None else len(side.batches) for side in (baseline, candidate)]
    if counts[0] < _FEWEST_PAIRS or counts[0] != counts[1]:
        cubes = f"{counts[0]} and {counts[1]} cubes"
        raise InputError("same seeds", cubes, f"{_FEWEST_PAIRS} or more of each side, joined by commas in one order")


def regress_pictures(
    baseline: Side,
    candidate: Side,
    view: View | None = None,
    false_alarms: float = FALSE_ALARMS,
    progress: Progress = NO_PROGRESS,
) -> Outcome:
    """Compare two sides, and name the change where they differ.

    Parameters
    ----------
    baseline, candidate
        The sides.
    view
        Scene and camera of both; None for the published box, if the baseline shows it.
    false_alarms
        Rate of false alarms of the verdict.
    progress
        Receiver of the finished part.

    Returns
    -------
    Outcome
        Verdict, tests, named change.

    Raises
    ------
    InputError
        If the sides cannot be compared.
    """
    progress.part(0.02)
    baseline, candidate, cut = on_common_pixels(sound_side(baseline), sound_side(candidate))
    baseline, candidate = in_common_quantity(baseline, candidate)
    notes: list[str] = [*cut]
    view = None if view is None else _cut_view(view, baseline)
    surfaces = baseline.surfaces or candidate.surfaces
    surfaces_stated = surfaces is not None
    # a scene that nobody stated is looked for only where the pictures differ
    variants = None if surfaces_stated or view is None else _variants(view, baseline, candidate, notes)
    if variants is not None:
        surfaces = variants.surface_map()
    outcome, comparison = regress_sides(baseline, candidate, surfaces, false_alarms)
    if not outcome.same and not surfaces_stated and view is None:
        variants = _variants(view, baseline, candidate, notes)
        if variants is not None:
            mapped = regress_sides(baseline, candidate, variants.surface_map(), false_alarms)
            # the verdict is that of the first look, which needs no assumption
            outcome, comparison = (outcome, comparison) if mapped[0].same else mapped
    progress.part(0.2)
    changes: tuple[NamedChange, ...] = ()
    if outcome.is_pattern:
        from .naming import pattern_alone

        changes = (pattern_alone(outcome.cancelling or ""),)
    elif outcome.deciding and all(row.kind in ("layer", "numbers") for row in outcome.deciding):
        from .naming import pattern_alone

        facts = ["the light is the same"] if np.isfinite(outcome.picture_mean.sigma) else []
        layers = " and ".join(row.name for row in outcome.of_kind("layer") if row.different)
        facts += [f"the {layers} layer differs"] if layers else []
        facts += [f"some pixels are {absent.state}" for absent in outcome.not_numbers.values()]
        changes = (pattern_alone(", ".join(facts)),)
    elif not outcome.same:
        from .naming import named_changes

        if variants is None and surfaces_stated:  # the pictures have not been compared with a scene yet
            variants = _variants(view, baseline, candidate, notes)
        changes = _mislabelled(baseline, candidate, surfaces, false_alarms)
        changes = changes or named_changes(comparison, variants, progress)
        if variants is None:
            notes.append("the scene is not known: changes of paths, paints, gloss and the lamp's size cannot be named")
    return replace(outcome, changes=changes, notes=(*outcome.notes, *notes))


def assert_same_light(
    baseline: str | Path,
    candidate: str | Path,
    *,
    model: str | Path | None = None,
    camera: str | Path | None = None,
    false_alarms: float = FALSE_ALARMS,
    declared: Declared | DeclaredPair = AS_STATED,
) -> Outcome:
    """Require that two pictures show the same light.

    Parameters
    ----------
    baseline, candidate, model, camera, false_alarms, declared
        As in ``regress_inputs``.

    Returns
    -------
    Outcome
        The outcome, where the light is the same.

    Raises
    ------
    AssertionError
        If the light differs; the message states where, and the named change.
    InputError
        If a picture is missing or cannot be compared.
    """
    arguments = {"baseline": baseline, "candidate": candidate} | ({} if model is None else {"model": model})
    for name, argument in arguments.items():
        require_type(name, argument, (str, Path), "a file, a model or a command, as a text or a path")
    view = None if camera is None else required_path("camera", camera, "a camera file or a capture")
    rate = required_number("false_alarms", false_alarms, above=0.0, most=0.5)
    require_type("declared", declared, (Declared, DeclaredPair), "a Declared or a DeclaredPair")
    scene = None if model is None else str(model)
    outcome = regress_inputs(str(baseline), str(candidate), scene, view, rate, declared=declared)
    if outcome.same:
        return outcome
    mean = outcome.picture_mean
    size = as_percent(mean.difference, "the baseline", unit="%")
    lines = [f"{candidate} differs from {baseline}: mean light {size} ± {mean.sigma:.3%}"]
    for row in outcome.deciding[:_MAX_LISTED_POOLS]:
        part = f"{row.difference:+.2%} ± {row.sigma:.2%}"
        part = part if row.unit == "1" else f"{row.difference:+.4g} ± {row.sigma:.2g} {row.unit}"
        lines.append(f"  {row.label}" if row.kind == "numbers" else f"  {row.label}: {part}")
    for change in outcome.changes[:_MAX_LISTED_CHANGES]:
        label = "cause" if change.change == UNKNOWN else "named" if change.fits else "most like"
        lines.append(f"  {label}: {change_text(change)} ({change.probability:.2f})")
    raise AssertionError("\n".join(lines))


def input_files(text: str) -> tuple[Path, ...]:
    """Files that an argument of ``regress_inputs`` is read from.

    Parameters
    ----------
    text
        The argument.

    Returns
    -------
    tuple of Path
        The files; none for a command and for a packaged scene.

    Raises
    ------
    InputError
        If a model file cannot be read, or if a folder holds no cube.
    """
    if _OUT in text:
        return ()
    if _is_model(text):
        from cboxlab.rendering.model import load_model

        return () if text in packaged_scenes() else (Path(text), *load_model(text).files)
    return tuple(file for path in cube_paths(text) for file in files_of(path))


def _read(text: str, declared: Declared) -> Side:
    """Side from cubes, or from a command that has {out} in place of a path without ending."""
    if _OUT not in text:
        return read_side(cube_paths(text), declared)
    with temporary_folder() as folder:
        command = text.replace(_OUT, shlex.quote(f"{folder}/picture"))
        process = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
        if process.returncode:
            message = (process.stderr.strip() or process.stdout.strip())[-_MAX_MESSAGE_LENGTH:]
            fault = f"it ended with {process.returncode}: {message}"
            raise InputError(text, fault, "a command that writes a picture")
        return replace(read_side(cube_paths(str(folder)), declared), source=text)


def _is_model(text: str) -> bool:
    """Whether an argument names a model file or a packaged scene."""
    return text.endswith(".toml") or (text in packaged_scenes() and not Path(text).exists())


def _camera_and_lamp(camera: Camera | Path | None, size: int | Sequence[int]) -> tuple[Camera, Spectrum | None]:
    """Camera, and the lamp of a capture; InputError where pictures are not of the camera's size."""
    from cboxlab.scenes.cornell_box import cornell_camera

    rows, columns = (size, size) if isinstance(size, int) else size
    if camera is None:
        if rows != columns:
            raise InputError("camera", f"pictures of {columns} x {rows} px", "a camera file or a capture folder")
        return cornell_camera(rows), None
    if isinstance(camera, Camera):
        view, lamp = camera, None
    else:
        from cboxlab.rendering.model import view_of  # slow to import, and only needed here

        view, lamp = view_of(camera)
    if not isinstance(size, int) and (view.height_px, view.width_px) != (rows, columns):
        raise InputError(str(camera), f"{view.width_px} x {view.height_px} px", f"{columns} x {rows} px, as the cubes")
    return view, lamp


def _picture_size(side: Side) -> tuple[int, int]:
    """Rows and columns of the picture that a side is a part of; its own where not stated."""
    display = side.pixels.display
    return side.shape if display is None else (display[3], display[2])


def _cut_view(view: View, side: Side) -> View:
    """The view through a camera of the side's pixels alone."""
    part, camera = side.pixels, view.camera
    if side.window is None or (camera.height_px, camera.width_px) == side.shape:
        return view
    display = part.display or (0, 0, camera.width_px, camera.height_px)
    return replace(view, camera=cut_camera(camera, Window(*display, display), part))


def _view(text: str, camera: Camera | Path | None, size: int | Sequence[int]) -> View:
    """Scene and camera of a model."""
    from cboxlab.rendering.model import load_model, model_cube_inputs

    scene, view, _ = model_cube_inputs(load_model(text), *_camera_and_lamp(camera, size))
    return View(scene, view, True)


def _published_view(camera: Camera | Path | None, size: int | Sequence[int]) -> View:
    """The published box, which the pictures may show, without the imports for models."""
    from cboxlab.scenes.cornell_box import cornell_box

    view, lamp = _camera_and_lamp(camera, size)
    scene = cornell_box()
    return View(scene if lamp is None else scene.with_lamp(lamp), view, False)


def _rendered(text: str, camera: Camera | Path | None, size: int | Sequence[int], grid: np.ndarray, seed: int) -> Side:
    """Side rendered from a model. seed : number of the side, which gets its own random numbers."""
    from cboxlab.rendering.integrators import BATCHES, RenderJob, render_image
    from cboxlab.rendering.model import labelled_cube, load_model, model_cube_inputs

    from ...predict import transported

    model = load_model(text)
    scene, view, bounces = model_cube_inputs(model, *_camera_and_lamp(camera, size))
    side_seed = model.render.seed + 7 * seed
    image = render_image(RenderJob(scene, view, grid, _SAMPLES, BATCHES, seed=side_seed, max_bounces=bounces))
    image = transported(image, scene, view, model.effects, side_seed, bounces)
    return side_of([labelled_cube(image)], [text])


def _variants(view: View | None, baseline: Side, candidate: Side, notes: list[str]) -> Variants | None:
    """Rendering of the stated scene, or of the published one where the baseline shows it."""
    from .variants import build_variants, mismatch

    if baseline.as_stored:
        if view is not None:
            expected = "X, Y, Z or spectra, next to a model"
            hint = "declare colour-space=NAME, units='cd m^-2' and scale=FACTOR to it."
            raise InputError(baseline.source, "R, G, B of no stated unit and colour space", expected, hint)
        return None
    if view is None:
        camera = baseline.camera or candidate.camera
        if camera is None and baseline.shape[0] != baseline.shape[1]:
            return None
        view = _published_view(camera, baseline.shape)
    try:
        variants = build_variants(view.scene, view.camera, baseline)
    except InputError as error:
        notes.append(f"changes that need the scene cannot be named: {error}")
        return None
    off = mismatch(variants, baseline)
    if view.scene_stated and off > _MAX_MISMATCH:
        notes.append(f"the baseline deviates from the stated model by {off:.0%}: is it the right model and camera?")
    if view.scene_stated:
        return variants
    if off > _MAX_MISMATCH:
        _log.info("the baseline does not show the published box: it deviates by %.0f %%", 100 * off)
        return None
    notes.append(f"the baseline shows the published box (within {off:.1%}), whose surfaces and light are used")
    return variants


def _mislabelled(baseline: Side, candidate: Side, surfaces: object, false_alarms: float) -> tuple[NamedChange, ...]:
    """Change of wavelengths alone: the pictures, plane by plane, are the same."""
    a, b = candidate.wavelength_nm, baseline.wavelength_nm
    if baseline.in_colour or a.size != b.size or np.allclose(a, b, atol=1e-3):
        return ()
    outcome, _ = regress_sides(baseline, replace(candidate, wavelength_nm=b), surfaces, false_alarms)  # type: ignore[arg-type]
    if not outcome.same:
        return ()
    return (NamedChange("wavelengths", {"labels_off_nm": float((a - b).mean())}, _MISLABELLED_PROBABILITY),)
