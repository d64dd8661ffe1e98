"""Tables of a folder that a first manifest can name: spectra, surveyed points, labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cboxlab.scenes.spectra import read_spectra
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.input_files import read_rows
from PIL import Image

from .folder_frames import LeftOut
from .labels import read_labels

__all__ = ["FolderTables", "tables_in"]

#: Columns of a file of surveyed points.
_POINTS_COLUMNS = frozenset({"id", "x_mm", "y_mm", "z_mm", "u_px", "v_px"})
#: By use, the names of files (without ``.csv``) whose column ``radiance`` is that of the source.
_RADIANCE_FILES = {
    "lamp": ("lamp",),
    "reference": ("sphere", "reference", "integrating-sphere", "integrating_sphere"),
    "flat": ("flat", "flatfield"),
}
#: Names of files whose columns are transmittances of filters.
_FILTER_FILES = ("filters", "filter", "transmittance", "transmittances")
#: By use, the names of columns that say it in any file.
_CAMERA_COLUMNS = {
    "quantum_efficiency": ("quantum_efficiency",),
    "lens": ("lens", "lens_transmittance"),
}
#: Names of files whose columns are the sensitivities of a mosaic's channels.
_CHANNEL_FILES = ("channels", "camera", "sensitivities", "sensitivity", "quantum_efficiency", "qe")


@dataclass(frozen=True)
class FolderTables(FrozenMappings):
    """Uses of the tables of a folder, as column references ``file.csv:column``."""

    #: By use ("lamp", "reference", "flat", "quantum_efficiency", "lens"), the column.
    columns: dict[str, str]
    #: By letter of the mosaic, the column of its sensitivity; empty unless there is one for each.
    channels: dict[str, str]
    #: By identifier of the band, the column of its filter.
    filters: dict[str, str]
    #: File of surveyed points; None without one.
    points: str | None
    #: By key of [labels], the file; empty without a label image and its table.
    labels: dict[str, str]
    #: Tables that are not used.
    left_out: tuple[LeftOut, ...]


def _header(path: Path) -> list[str]:
    """Names of the columns of a CSV file."""
    rows = read_rows(path, "a table in CSV")
    return [name.strip() for name in rows[0][1]] if rows else []


def _is_label_image(path: Path, shape: tuple[int, int]) -> bool:
    """Whether a PNG has one 8-bit channel and the size of the frames."""
    try:
        with Image.open(path) as picture:
            return picture.mode in ("L", "P") and (picture.height, picture.width) == shape
    except (Image.DecompressionBombError, OSError, ValueError, SyntaxError):
        return False


def _labels(folder: Path, paths: Sequence[Path], shape: tuple[int, int]) -> dict[str, str]:
    """Files of [labels]: the only label image, the only table of labels, their reflectances.

    Empty unless there is one image and one table.
    """
    images = [path for path in sorted(folder.glob("*.png")) if _is_label_image(path, shape)]
    tables = {path: columns for path in paths if (columns := _label_columns(path)) is not None}
    if len(images) != 1 or len(tables) != 1:
        return {}
    ((table, columns),) = tables.items()
    files = {"image": images[0].name, "names": table.relative_to(folder).as_posix()}
    spectra = [path for path in paths if columns.intersection(_spectra_columns(path))]
    if len(spectra) == 1:
        files["reflectance"] = spectra[0].relative_to(folder).as_posix()
    return files


def _label_columns(path: Path) -> set[str] | None:
    """Reflectance columns that a sound table of labels names; None for another table."""
    try:
        return {label.column for label in read_labels(path) if label.column is not None}
    except InputError:
        return None


def _spectra_columns(path: Path) -> list[str]:
    """Columns of a sound table of spectra; empty for another table."""
    try:
        return list(read_spectra(path))
    except InputError:
        return []


def tables_in(folder: Path, bands: Sequence[str], shape: tuple[int, int], letters: Sequence[str] = ()) -> FolderTables:
    """The tables of a folder and of its subfolder ``spectra``.

    A table is used where its columns say what it is. Surveyed points have columns of their names. A filter is a column
    of the band's name in ``filters.csv``. A channel's sensitivity is a column of its letter in ``channels.csv``. A
    radiance is the column ``radiance`` of ``lamp.csv``, ``sphere.csv`` or ``flat.csv``. A use that two columns claim is
    left to the user.

    Parameters
    ----------
    folder
        The folder.
    bands
        Identifiers of the bands.
    shape
        (height, width) of the frames, px.
    letters
        Channels of the mosaic; empty without one.

    Returns
    -------
    FolderTables
        The uses, and the tables without one.
    """
    claims: dict[tuple[str, str], list[str]] = {}
    faults: dict[str, str] = {}
    paths = [
        path
        for parent in (folder, folder / "spectra")
        if parent.is_dir()
        for path in sorted(parent.iterdir())
        if path.suffix.lower() == ".csv" and path.is_file() and not path.name.startswith(".")
    ]
    labels = _labels(folder, paths, shape)
    for path in paths:
        listed = path.relative_to(folder).as_posix()
        try:
            _claim(path, listed, bands, letters, claims)
        except InputError as fault:
            faults[listed] = f"{fault.found}; expected {fault.expected}"
    single = {use: references[0] for use, references in claims.items() if len(references) == 1}
    channels = {use: reference for (kind, use), reference in single.items() if kind == "channel"}
    if set(channels) != set(letters):
        single = {use: reference for use, reference in single.items() if use[0] != "channel"}
        channels = {}
    used = {reference.partition(":")[0] for reference in single.values()}
    used |= set(labels.values())
    left_out = []
    for path in paths:
        listed = path.relative_to(folder).as_posix()
        if listed not in used:
            doubles = [use[1] for use, refs in claims.items() if len(refs) > 1 and any(listed in r for r in refs)]
            why = f"{', '.join(doubles)} stands in several tables" if doubles else "a table whose use is not certain"
            left_out.append(LeftOut(listed, f"{faults.get(listed, why)}: name it in capture.toml"))
    return FolderTables(
        {use: reference for (kind, use), reference in single.items() if kind == "column"},
        channels,
        {band: reference for (kind, band), reference in single.items() if kind == "filter"},
        single.get(("points", "points")),
        labels,
        tuple(left_out),
    )


def _claim(
    path: Path, listed: str, bands: Sequence[str], letters: Sequence[str], claims: dict[tuple[str, str], list[str]]
) -> None:
    """Add the uses of a table to ``claims``. Raises InputError for a faulty table of spectra."""
    names, stem = _header(path), path.stem.lower()
    if _POINTS_COLUMNS == set(names):
        claims.setdefault(("points", "points"), []).append(listed)
    if not names or names[0] != "wavelength_nm":
        return
    for name in read_spectra(path):
        for use, columns in _CAMERA_COLUMNS.items():
            if name in columns:
                claims.setdefault(("column", use), []).append(f"{listed}:{name}")
        for use, files in _RADIANCE_FILES.items():
            if name == "radiance" and stem in files:
                claims.setdefault(("column", use), []).append(f"{listed}:{name}")
        if name.upper() in letters and stem in _CHANNEL_FILES:
            claims.setdefault(("channel", name.upper()), []).append(f"{listed}:{name}")
        if name in bands and stem in _FILTER_FILES:
            claims.setdefault(("filter", name), []).append(f"{listed}:{name}")
