"""Checks of a capture beyond its keys: cross-references in the manifest, and its files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from cboxlab.scenes import NAMED_CAMERA
from cboxlab.scenes.spectra import Spectrum, read_spectra
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import suggestion
from cboxlab.utils.input_files import kind_of
from PIL import Image, UnidentifiedImageError

from ..frame_readers import MissingPackageError
from .frames import check_frame, split_name
from .labels import read_labels
from .manifest import CameraTable, NoiseTable, TargetTable, channel_letters, example_of, is_channel
from .reduction import mosaic_side
from .whole_manifest import Manifest

__all__ = ["TABLES_OF_FRAMES", "capture_faults"]


#: Keys of the tables that name frames.
TABLES_OF_FRAMES = ("band", "dark", "flat", "reference", "bracket", "target")

#: Numbers of coefficients of a polynomial, and of a fisheye.
_COEFFICIENTS = {None: 5, "fisheye": 4}

#: Largest deviation of a unit vector's length from 1, and of the cosine between two from 0: 0.06 degrees.
_AXIS_TOLERANCE = 1e-3


def _frame_lists(manifest: Manifest) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Key and frame paths of every table of the manifest."""
    for key in TABLES_OF_FRAMES:
        tables = getattr(manifest, key)
        for index, table in enumerate(() if isinstance(tables, str) else tables):
            yield f"{key}[{index}].frames", table.frames


def _references(manifest: Manifest) -> Iterator[tuple[str, str]]:
    """Key and column reference of every spectrum that the manifest names."""
    efficiency = manifest.camera.quantum_efficiency
    if isinstance(efficiency, dict):
        for channel, of_channel in efficiency.items():
            yield f"camera.quantum_efficiency.{channel}", of_channel
    else:
        for column in efficiency if isinstance(efficiency, tuple) else (efficiency,):
            if column is not None:
                yield "camera.quantum_efficiency", column
    if manifest.lens.transmittance is not None:
        yield "lens.transmittance", manifest.lens.transmittance
    if manifest.lamp is not None:
        yield "lamp.radiance", manifest.lamp.radiance
    for index, band in enumerate(manifest.band):
        if band.transmittance is not None:
            yield f"band[{index}] ({band.id}).transmittance", band.transmittance
    for index, flat in enumerate(manifest.flats):
        if flat.radiance is not None:
            yield f"flat[{index}] ({flat.band}).radiance", flat.radiance
    for index, reference in enumerate(manifest.reference):
        yield f"reference[{index}] ({reference.band}).radiance", reference.radiance


def _consistency_faults(path: Path, manifest: Manifest) -> Iterator[InputError]:
    """Contradictions within the manifest, without a look at its files."""
    band_ids = [band.id for band in manifest.band]
    for index, identifier in enumerate(band_ids):
        if identifier in band_ids[:index]:
            yield InputError(
                f"{path}: band[{index}].id",
                f"'{identifier}' a second time",
                "a different id for each band",
                "Further exposures of a band are [[bracket]] tables.",
            )
    for key in ("flats", "reference", "bracket"):
        for index, table in enumerate(getattr(manifest, key)):
            if table.band not in band_ids:
                yield InputError(
                    f"{path}: {key.removesuffix('s')}[{index}].band",
                    f"'{table.band}'",
                    f"one of {', '.join(dict.fromkeys(band_ids))}",
                    suggestion(table.band, band_ids),
                )
    exposures = [dark.exposure_s for dark in manifest.darks]
    for index, exposure in enumerate(exposures):
        if exposure in exposures[:index]:
            yield InputError(
                f"{path}: dark[{index}].exposure_s",
                f"{exposure:g} s a second time",
                "one [[dark]] per exposure",
                "List all its frames in one table.",
            )
    yield from _mosaic_faults(path, manifest)
    yield from _level_faults(path, manifest)
    yield from _lens_faults(path, manifest)
    yield from _reduction_faults(path, manifest)
    yield from _noise_faults(path, manifest)
    camera = manifest.camera
    crop = manifest.crop
    if crop is not None:
        for axis, start, size, full in (
            ("width", crop.u0_px, camera.width_px, crop.full_width_px),
            ("height", crop.v0_px, camera.height_px, crop.full_height_px),
        ):
            if start + size > full:
                yield InputError(
                    f"{path}: crop",
                    f"a window that ends at {start + size} px",
                    f"an end within full_{axis}_px = {full}",
                )


def _noise_faults(path: Path, manifest: Manifest) -> Iterator[InputError]:
    """Contradictions between the kind of noise of merged pictures and its keys."""
    noise = manifest.noise
    if noise is None:
        return
    keys = [key for key in ("gain_e_per_unit", "read_noise_e") if getattr(noise, key) is not None]
    if noise.kind == "poisson" and noise.gain_e_per_unit is None:
        example = example_of(NoiseTable, "gain_e_per_unit")
        yield InputError(f"{path}: noise.gain_e_per_unit", "nothing", "this key", f"Add it, such as {example}")
    if noise.kind != "poisson" and keys:
        hint = f'Leave it out, or state kind = "poisson", not "{noise.kind}".'
        yield InputError(f"{path}: noise.{keys[0]}", "a key of kind = 'poisson'", "no such key", hint)


def _lens_faults(path: Path, manifest: Manifest) -> Iterator[InputError]:
    """Contradictions among the keys of [lens], and in the place of boards."""
    lens = manifest.lens
    if lens.fy_px is not None and lens.fx_px is None:
        yield InputError(f"{path}: lens.fy_px", "no fx_px with it", "both, or fx_px alone for square pixels")
    count = _COEFFICIENTS[lens.model]
    if lens.distortion is not None and len(lens.distortion) != count:
        order = "k1, k2, k3, k4 of a fisheye" if lens.model == "fisheye" else "k1, k2, p1, p2, k3"
        yield InputError(
            f"{path}: lens.distortion",
            f"{len(lens.distortion)} numbers",
            f"{count}: {order}",
            "Write 0.0 for a term that the lens does not have.",
        )
    for index, target in enumerate(manifest.target):
        yield from _place_faults(f"{path}: target[{index}]", target)


def _place_faults(where: str, target: TargetTable) -> Iterator[InputError]:
    """Missing or wrong keys of a board's place."""
    keys = {"origin_mm": target.origin_mm, "right": target.right, "down": target.down}
    present = [key for key, value in keys.items() if value is not None]
    if not present:
        return
    if target.right is None or target.down is None or target.origin_mm is None:
        missing = [key for key in keys if key not in present]
        yield InputError(where, f"{', '.join(present)} without {', '.join(missing)}", "all three, or none")
        return
    for key, axis in (("right", target.right), ("down", target.down)):
        length = float(np.linalg.norm(axis))
        if abs(length - 1) > _AXIS_TOLERANCE:
            yield InputError(f"{where}.{key}", f"a vector of length {length:.4g}", "a unit vector in the box's axes")
            return
    angle = float(np.degrees(np.arccos(np.clip(np.dot(target.right, target.down), -1, 1))))
    if abs(np.dot(target.right, target.down)) > _AXIS_TOLERANCE:
        yield InputError(
            f"{where}.down",
            f"an angle of {angle:.2f} degrees to right",
            "90 degrees",
            "Rows cross columns at right angles.",
        )


def _reduction_faults(path: Path, manifest: Manifest) -> Iterator[InputError]:
    """A window outside the frame, blocks larger than it, and blocks behind a mosaic."""
    camera = manifest.camera
    width, height = camera.width_px, camera.height_px
    if camera.window_px is not None:
        u0, v0, columns, rows = camera.window_px
        if min(u0, v0) < 0 or min(columns, rows) < 1 or u0 + columns > width or v0 + rows > height:
            expected = f"first column, first row, columns and rows within {width} x {height} px"
            yield InputError(f"{path}: camera.window_px", f"{list(camera.window_px)}", expected)
            return
        width, height = columns, rows
    if camera.binning is not None and camera.binning > min(width, height):
        yield InputError(f"{path}: camera.binning", f"{camera.binning}", f"at most {min(width, height)}")
    if camera.binning in (None, 1):
        return
    if manifest.noise is not None:
        fault = f"{camera.binning} with [noise]: its values are no counts"
        yield InputError(f"{path}: camera.binning", fault, "1, or no binning")
    elif manifest.mosaic is not None and mosaic_side(manifest.mosaic.pattern, camera.binning) != camera.binning:
        step = next(side for side in range(2, 2**16) if mosaic_side(manifest.mosaic.pattern, side) == side) - 1
        expected = ", ".join(str(1 + k * step) for k in range(4))
        yield InputError(
            f"{path}: camera.binning",
            f"{camera.binning} with the mosaic {manifest.mosaic.pattern}",
            f"{expected} and so on, by which the pattern stays",
        )


def _mosaic_faults(path: Path, manifest: Manifest) -> Iterator[InputError]:
    """Contradictions between the mosaic, the quantum efficiencies and the bands' channels."""
    where, efficiency = f"{path}: camera.quantum_efficiency", manifest.camera.quantum_efficiency
    if manifest.mosaic is None:
        if isinstance(efficiency, tuple):
            yield InputError(where, "a list", "one column", "A list needs [mosaic].")
        if isinstance(efficiency, dict):
            yield InputError(where, "a table", "one column", "A table needs [mosaic].")
        for index, band in enumerate(manifest.band):
            if band.channel is not None:
                key = f"{path}: band[{index}] ({band.id}).channel"
                yield InputError(key, f"'{band.channel}'", "no channel", "A channel needs [mosaic].")
        return
    letters = channel_letters(manifest.mosaic.pattern)
    if isinstance(efficiency, str):
        expected = "a list of three, R, G, B, or a table of letters, since the sensor has a [mosaic]"
        yield InputError(where, "one column", expected)
    if isinstance(efficiency, tuple) and not set(letters) <= set("RGB"):
        yield InputError(where, "a list, which stands for R, G, B", f"a table with {', '.join(letters)}")
    if isinstance(efficiency, dict) and set(efficiency) != set(letters):
        yield InputError(where, f"a table with {', '.join(efficiency)}", f"one with {', '.join(letters)}")
    for index, band in enumerate(manifest.band):
        if band.channel is not None and not is_channel(manifest.mosaic.pattern, band.channel):
            yield InputError(
                f"{path}: band[{index}] ({band.id}).channel",
                f"'{band.channel}'",
                f"one of {', '.join(letters)}, or one pixel of the repeat, such as '{letters[0]}1'",
            )


def _level_faults(path: Path, manifest: Manifest) -> Iterator[InputError]:
    """Black and white levels that the counts or the mosaic do not allow."""
    camera, full_scale = manifest.camera, 2**manifest.camera.bit_depth - 1
    black, white = camera.black_level_dn, camera.white_level_dn
    where = f"{path}: camera.black_level_dn"
    if isinstance(black, dict):
        pattern = "" if manifest.mosaic is None else manifest.mosaic.pattern
        letters = channel_letters(pattern)
        if not letters:
            yield InputError(where, "a table", "one number", "A table needs [mosaic].")
        elif not set(letters) <= set(black) or not all(is_channel(pattern, channel) for channel in black):
            yield InputError(where, f"a table with {', '.join(black)}", f"one with {', '.join(letters)}")
    highest = max(black.values(), default=0.0) if isinstance(black, dict) else black or 0.0
    limit = full_scale if white is None else min(white, full_scale)
    if highest >= limit:
        yield InputError(where, f"{highest:g} DN", f"less than the white level, {limit:g} DN")
    if white is not None and white > full_scale:
        expected = f"at most the largest count, {full_scale} DN for {camera.bit_depth} bits"
        yield InputError(f"{path}: camera.white_level_dn", f"{white:g} DN", expected)


def _check_file(folder: Path, path: Path, key: str, name: str) -> None:
    """Raise InputError for a path that is missing, leaves the folder or cannot be a file."""
    try:
        inside = (folder / name).resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError) as error:  # link loops, null bytes, names that are too long
        raise InputError(f"{path}: {key}", f"{name!r} ({error})", "a file inside the folder") from None
    if not inside:
        raise InputError(
            f"{path}: {key}",
            f"'{name}', which leaves the folder",
            "a file inside the folder",
            "Copy the file into the folder instead of linking to it.",
        )
    if not (folder / name).is_file():
        fault = f"which is {kind_of(folder / name)}" if (folder / name).exists() else "which does not exist"
        meant = [other for other in folder.rglob("*") if other.relative_to(folder).as_posix().lower() == name.lower()]
        hint = f"Did you mean '{meant[0].relative_to(folder).as_posix()}'?" if meant else ""
        raise InputError(f"{path}: {key}", f"'{name}', {fault}", "a file of the capture", hint)


def _is_readable(path: Path) -> bool:
    """Whether a file can be looked into; ``_check_file`` says why not."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _check_labels_image(path: Path, height: int, width: int) -> None:
    """Raise InputError for a label image of another size or type than the format states."""
    try:
        with Image.open(path) as image:
            image.load()
            content = f"{image.format} of mode {image.mode}, {image.width} x {image.height} px"
            fits = image.mode in ("L", "P") and (image.height, image.width) == (height, width)
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError, SyntaxError):
        content, fits = "a file that is not an image", False
    if not fits:
        raise InputError(path, content, f"an 8-bit one-channel PNG of {width} x {height} px")


def _check_spectrum(
    folder: Path, path: Path, key: str, reference: str, tables: dict[str, dict[str, Spectrum] | None]
) -> None:
    """Raise InputError for a missing file or column; each file is read once, into ``tables``."""
    name, _, column = reference.rpartition(":")
    if name not in tables:
        tables[name] = None  # so that a faulty file is named once
        _check_file(folder, path, key, name)
        tables[name] = read_spectra(folder / name)
    spectra = tables[name]
    if spectra is not None and column not in spectra:
        raise InputError(
            f"{path}: {key}",
            f"no column '{column}' in {name}",
            f"one of {', '.join(spectra)}",
            suggestion(column, spectra),
        )


def _file_checks(folder: Path, path: Path, manifest: Manifest) -> Iterator[Callable[[], None]]:
    """All checks of files, each to be called; it raises InputError for a fault."""
    camera, labels = manifest.camera, manifest.labels
    for key, names in _frame_lists(manifest):
        for name in names:
            file, number = _file_of(folder, name)
            yield partial(_check_file, folder, path, key, file)
            if _is_readable(folder / file):
                merged = manifest.noise is not None
                yield partial(_check_pictures, f"{path}: {key}", folder / file, number, camera, merged)
        yield partial(_check_once, folder, f"{path}: {key}", names)
    tables: dict[str, dict[str, Spectrum] | None] = {}
    for key, reference in _references(manifest):
        if reference.startswith(NAMED_CAMERA):
            continue
        yield partial(_check_spectrum, folder, path, key, reference, tables)
    if manifest.geometry is not None:
        yield partial(_check_file, folder, path, "geometry.points", manifest.geometry.points)
    if labels is not None:
        if labels.image is not None:
            yield partial(_check_file, folder, path, "labels.image", labels.image)
            if _is_readable(folder / labels.image):
                yield partial(_check_labels_image, folder / labels.image, camera.height_px, camera.width_px)
        yield partial(_check_file, folder, path, "labels.names", labels.names)
        if _is_readable(folder / labels.names):
            yield partial(_check_label_table, folder / labels.names)
        if labels.reflectance is not None:
            yield partial(_check_file, folder, path, "labels.reflectance", labels.reflectance)
            if _is_readable(folder / labels.reflectance):
                yield partial(_check_reflectances, folder / labels.reflectance)


def _file_of(folder: Path, name: str) -> tuple[str, int | None]:
    """File and picture of a frame; the name itself where it cannot be a path."""
    try:
        return split_name(folder, name)
    except (OSError, ValueError):
        return name, None


def _check_pictures(where: str, path: Path, number: int | None, camera: CameraTable, merged: bool) -> None:
    """Raise InputError for a file that is no frame of the camera, or lacks the picture."""
    one_band = number is not None
    count = check_frame(path, camera.height_px, camera.width_px, one_band=one_band, merged=merged).pictures
    if number is not None and number >= count:
        raise InputError(
            where, f"the picture [{number}] of {path.name}", f"0 to {count - 1}: it holds {count} pictures"
        )


def _check_once(folder: Path, where: str, names: Sequence[str]) -> None:
    """Raise InputError for a picture that stands by its number next to all pictures of its file."""
    pairs = [_file_of(folder, name) for name in names]
    whole_files = {file for file, number in pairs if number is None}
    for name, (file, number) in zip(names, pairs, strict=True):
        if number is not None and file in whole_files:
            raise InputError(where, f"'{name}' next to '{file}'", "each picture listed once")


def _check_label_table(path: Path) -> None:
    read_labels(path)


def _check_reflectances(path: Path) -> None:
    for name, spectrum in read_spectra(path).items():
        if np.any(spectrum.values < 0):
            raise InputError(f"{path}: {name}", "a reflectance below 0", "0 or more")


def capture_faults(folder: Path, manifest: Manifest) -> list[InputError]:
    """All contradictions within the manifest and between it and the files of its folder.

    Of frames only the headers are checked; spectra and label tables are checked completely.

    Parameters
    ----------
    folder
        Folder of the capture.
    manifest
        Its manifest.

    Returns
    -------
    list
        One InputError per fault; empty if there are none.
    """
    path = folder / "capture.toml"
    faults = list(_consistency_faults(path, manifest))
    packages: set[str] = set()
    for check in _file_checks(folder, path, manifest):
        try:
            check()
        except MissingPackageError as fault:
            if fault.found not in packages:  # one package may be missing for every frame
                faults.append(fault)
            packages.add(fault.found)
        except InputError as fault:
            faults.append(fault)
    return faults
