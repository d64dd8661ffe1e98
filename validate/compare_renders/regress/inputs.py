"""From what the command line names to an outcome: cubes read, models rendered, the scene found."""

from __future__ import annotations

import shlex
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from cboxlab.rendering.files import AS_STATED, Declared, DeclaredPair, Window, files_of
from cboxlab.rendering.integrators import BATCHES, render
from cboxlab.rendering.model import labelled_cube, load_model, model_cube_inputs, view_of
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.cornell_box import cornell_camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.scene_file import packaged_scenes
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import temporary_folder
from cboxlab.utils.progress import QUIET, Progress

from ...predict import transported
from .naming import named_changes
from .outcome import NamedChange, Outcome, as_percent, told_change
from .sides import Side, cube_paths, cut_camera, in_common_quantity, on_common_pixels, read_side, side_of
from .variants import Variants, build_variants, mismatch
from .verdict import FALSE_ALARMS, regress_sides

__all__ = ["SIDES", "assert_same_light", "input_files", "regress_inputs", "regress_pictures"]

#: Pictures that deviate less from the published box's (see ``mismatch``) show it.
_RECOGNISED = 0.05
_PUBLISHED = "cornell-box"
#: What the two are called where something is declared for one of them.
SIDES = ("baseline", "candidate")
#: In a command, where it writes; characters of a failed command's own words that are repeated.
_OUT, _MOST_WORDS = "{out}", 400
#: Of models rendered on the fly where both sides are models.
_SIZE_PX, _WAVELENGTHS_NM = 128, np.arange(400.0, 701.0, 20.0)
_SAMPLES = 64


@dataclass(frozen=True, eq=False)
class View:
    """The scene that both sides show. stated : whether the user says so; else it has to be recognised."""

    scene: Scene
    camera: Camera
    stated: bool


def regress_inputs(
    baseline: str,
    candidate: str,
    model: str | None = None,
    camera: Path | None = None,
    false_alarms: float = FALSE_ALARMS,
    progress: Progress = QUIET,
    *,
    declared: Declared | DeclaredPair = AS_STATED,
) -> Outcome:
    """Compare what two arguments of the command line name, and name the change where they differ.

    Each is a spectral cube, several joined by commas, a folder of cubes, a command that writes one or more, such as
    "ourrenderer box.xml -o {out}.exr", run by the shell, a model file or a packaged scene; models are rendered at the
    other side's size and wavelengths. model, camera : what the cubes show, the latter a camera file or a capture
    folder. Without a camera it is the one that a cube states, else the published one; without a model it is the
    published box, if the baseline shows it. declared : what the files do not state, of both or
    of each.

    Raises InputError for what cannot be read or compared.
    """
    pair = declared if isinstance(declared, DeclaredPair) else DeclaredPair(SIDES, declared)
    sides = [
        None if _is_model(text) else _read(text, pair.of(index)) for index, text in enumerate((baseline, candidate))
    ]
    used = [() if side is None else side.declared for side in sides]
    instead = [{} if side is None else side.stated for side in sides]
    pair.require_used((used[0], used[1]), (instead[0], instead[1]))
    known = next((side for side in sides if side is not None), None)
    seen = camera or next((side.camera for side in sides if side is not None and side.camera), None)
    stated = model or next((text for text in (baseline, candidate) if _is_model(text)), None)
    size = _SIZE_PX if known is None else _picture_size(known)
    view = None if stated is None else _view(stated, seen, size)
    if view is None and camera is not None:
        view = replace(_view(_PUBLISHED, camera, size), stated=False)
    grid = _WAVELENGTHS_NM if known is None or known.in_colour else known.wavelength_nm
    ready = [
        _rendered(text, seen, size, grid, seed) if side is None else side
        for seed, (text, side) in enumerate(zip((baseline, candidate), sides, strict=True))
    ]
    return regress_pictures(ready[0], ready[1], view, false_alarms, progress)


def regress_pictures(
    baseline: Side,
    candidate: Side,
    view: View | None = None,
    false_alarms: float = FALSE_ALARMS,
    progress: Progress = QUIET,
) -> Outcome:
    """Verdict and, where the sides differ, the named change. view : the scene, else the published one if it fits."""
    progress.part(0.02)
    baseline, candidate, cut = on_common_pixels(baseline, candidate)
    baseline, candidate = in_common_quantity(baseline, candidate)
    notes: list[str] = [*cut]
    view = None if view is None else _cut_view(view, baseline)
    surfaces = baseline.surfaces or candidate.surfaces
    variants = None
    if surfaces is None:
        variants = _variants(view, baseline, candidate, notes)
        surfaces = None if variants is None else variants.surface_map()
    outcome, found = regress_sides(baseline, candidate, surfaces, false_alarms)
    progress.part(0.2)
    named: tuple[NamedChange, ...] = ()
    if not outcome.same:
        variants = variants or _variants(view, baseline, candidate, notes)
        named = _mislabelled(baseline, candidate, surfaces, false_alarms) or named_changes(found, variants, progress)
        if variants is None:
            notes.append("the scene is not known: changes of paths, paints, gloss and the lamp's size cannot be named")
    return replace(outcome, named=named, notes=(*outcome.notes, *notes))


def assert_same_light(
    baseline: str | Path,
    candidate: str | Path,
    *,
    model: str | None = None,
    camera: Path | None = None,
    false_alarms: float = FALSE_ALARMS,
    declared: Declared | DeclaredPair = AS_STATED,
) -> Outcome:
    """The outcome where both show the same light; otherwise AssertionError that tells where, and what changed.

    Arguments as ``regress_inputs``. Raises InputError for a missing baseline.
    """
    outcome = regress_inputs(str(baseline), str(candidate), model, camera, false_alarms, declared=declared)
    if outcome.same:
        return outcome
    whole = outcome.whole
    size = as_percent(whole.difference, "the baseline", unit="%")
    lines = [f"{candidate} differs from {baseline}: mean light {size} ± {whole.sigma:.3%}"]
    lines += [f"  {row.kind} {row.name}: {row.difference:+.4g} ± {row.sigma:.2g}" for row in outcome.deciding[:5]]
    lines += [f"  named: {told_change(n)} ({n.probability:.2f})" for n in outcome.named[:3]]
    raise AssertionError("\n".join(lines))


def input_files(text: str) -> tuple[Path, ...]:
    """The files that a side of a comparison is read from; none for a command and for a packaged scene."""
    if _OUT in text:
        return ()
    if _is_model(text):
        return () if text in packaged_scenes() else (Path(text), *load_model(text).files)
    return tuple(file for path in cube_paths(text) for file in files_of(path))


def _read(text: str, declared: Declared) -> Side:
    """Cubes, or what a command writes, which has {out} in the place of a path without ending."""
    if _OUT not in text:
        return read_side(cube_paths(text), declared)
    with temporary_folder() as folder:
        command = text.replace(_OUT, shlex.quote(f"{folder}/picture"))
        done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
        if done.returncode:
            words = (done.stderr.strip() or done.stdout.strip())[-_MOST_WORDS:]
            raise InputError(text, f"it ended with {done.returncode}: {words}", "a command that writes a picture")
        return replace(read_side(cube_paths(str(folder)), declared), source=text)


def _is_model(text: str) -> bool:
    return text.endswith(".toml") or (text in packaged_scenes() and not Path(text).exists())


def _seen(camera: Camera | Path | None, size: int | Sequence[int]) -> tuple[Camera, Spectrum | None]:
    """Camera and lamp. Raises InputError where the pictures are not of the camera's size."""
    rows, columns = (size, size) if isinstance(size, int) else size
    if camera is None:
        if rows != columns:
            raise InputError("camera", f"pictures of {columns} x {rows} px", "a camera file or a capture folder")
        return cornell_camera(rows), None
    found, lamp = view_of(camera)
    if not isinstance(size, int) and (found.height_px, found.width_px) != (rows, columns):
        raise InputError(
            str(camera), f"{found.width_px} x {found.height_px} px", f"{columns} x {rows} px, as the cubes"
        )
    return found, lamp


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
    scene, view, _ = model_cube_inputs(load_model(text), *_seen(camera, size))
    return View(scene, view, True)


def _rendered(text: str, camera: Camera | Path | None, size: int | Sequence[int], grid: np.ndarray, seed: int) -> Side:
    chosen = load_model(text)
    scene, view, bounces = model_cube_inputs(chosen, *_seen(camera, size))
    own = chosen.render.seed + 7 * seed
    image = render(scene, view, grid, _SAMPLES, BATCHES, seed=own, max_bounces=bounces)
    image = transported(image, scene, view, chosen.effects, own, bounces)
    return side_of([labelled_cube(image)], [text])


def _variants(view: View | None, baseline: Side, candidate: Side, notes: list[str]) -> Variants | None:
    """Of the stated scene, or of the published one where the baseline shows it."""
    if view is None:
        camera = baseline.camera or candidate.camera
        if camera is None and baseline.shape[0] != baseline.shape[1]:
            return None
        view = replace(_view(_PUBLISHED, camera, baseline.shape), stated=False)
    try:
        variants = build_variants(view.scene, view.camera, baseline)
    except InputError as error:
        notes.append(f"changes that need the scene cannot be named: {error}")
        return None
    off = mismatch(variants, baseline)
    if view.stated and off > _RECOGNISED:
        notes.append(f"the baseline deviates from the stated model by {off:.0%}: is it the right model and camera?")
    if view.stated:
        return variants
    if off > _RECOGNISED:
        return None
    notes.append(f"the baseline shows the published box (within {off:.1%}), whose surfaces and light are used")
    return variants


def _mislabelled(baseline: Side, candidate: Side, surfaces: object, false_alarms: float) -> tuple[NamedChange, ...]:
    """Wavelengths that differ between the files though the pictures, plane by plane, do not."""
    a, b = candidate.wavelength_nm, baseline.wavelength_nm
    if baseline.in_colour or a.size != b.size or np.allclose(a, b, atol=1e-3):
        return ()
    outcome, _ = regress_sides(baseline, replace(candidate, wavelength_nm=b), surfaces, false_alarms)  # type: ignore[arg-type]
    if not outcome.same:
        return ()
    return (NamedChange("wavelengths", {"labels_off_nm": float((a - b).mean())}, 0.99),)
