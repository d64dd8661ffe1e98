"""Files of a data set: state, folders of boxes, records of pictures, index."""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from cboxlab.rendering.dataset import Recipe
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.input_files import read_json_object

__all__ = [
    "FAILED",
    "FORMAT",
    "FRACTIONS",
    "INDEX",
    "WHOLE_NUMBERS",
    "Layout",
    "begin",
    "read_state",
    "versions",
    "write_index",
]

#: Format of the folder.
FORMAT = "dataset/1"
#: File of the state.
STATE = "dataset.json"
#: File of the index.
INDEX = "index.csv"
#: Columns of the index.
_COLUMNS = (
    "picture",
    "box",
    "geometry",
    "camera",
    "part",
    "file",
    "model",
    "relative_standard_error",
    "mean_luminance",
    "effects",
    "bytes",
    "sha256",
)
#: Columns of the index that hold whole numbers.
WHOLE_NUMBERS = ("picture", "box", "geometry", "bytes")
#: Columns of the index that hold other numbers.
FRACTIONS = ("relative_standard_error", "mean_luminance")
#: Folder of the pictures that pass their checks.
BOXES = "boxes"
#: Folder of the pictures that fail a check.
FAILED = "failed"

#: Packages on which the bits of a picture's file depend.
_PACKAGES = ("cboxlab", "mitsuba", "drjit", "numpy", "scipy", "isal")


class Layout:
    """Paths of a data set.

    Parameters
    ----------
    folder
        Folder of the data set.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)

    def box(self, number: int, failed: bool = False) -> Path:
        """Folder of a box.

        Parameters
        ----------
        number
            Number of the box.
        failed
            Whether it is that of pictures which fail a check.

        Returns
        -------
        Path
            The folder.
        """
        return self.folder / (FAILED if failed else BOXES) / f"{number:06d}"

    def record(self, number: int, camera: str) -> dict[str, Any] | None:
        """Record of a finished picture.

        Parameters
        ----------
        number
            Number of the box.
        camera
            Name of the camera.

        Returns
        -------
        dict or None
            None unless picture and record are complete.
        """
        for failed in (False, True):
            path = self.box(number, failed) / f"{camera}.json"
            try:
                record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
                size = (self.folder / record["file"]).stat().st_size
            except (OSError, ValueError, KeyError, TypeError):
                continue
            if size == record.get("bytes"):
                return record
        return None

    def store(self, number: int, camera: str, record: dict[str, Any]) -> None:
        """Write the record of a picture, after its file.

        Parameters
        ----------
        number
            Number of the box.
        camera
            Name of the camera.
        record
            The record.
        """
        path = self.box(number, bool(record["faults"])) / f"{camera}.json"
        write_json(path, record)


def write_json(path: Path, content: object) -> None:
    """Write a JSON file, completely or not at all.

    Parameters
    ----------
    path
        The file.
    content
        The content.
    """
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_box(layout: Layout, number: int) -> dict[str, Any]:
    """Values that were drawn for a box.

    Parameters
    ----------
    layout
        Files of the data set.
    number
        Number of the box.

    Returns
    -------
    dict
        Content of box.json.
    """
    for failed in (False, True):
        path = layout.box(number, failed) / "box.json"
        if path.exists():
            return read_json_object(path, "the drawn values of a box")
    raise InputError(layout.box(number), "no box.json", "the drawn values of a box")


def file_hash(path: Path) -> str:
    """SHA-256 of a file.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    str
        Hexadecimal digits.
    """
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def versions() -> dict[str, str]:
    """Versions of the packages on which a picture depends.

    Returns
    -------
    dict
        Version by package.
    """
    return {name: version(name) for name in _PACKAGES}


def read_state(folder: Path) -> dict[str, Any]:
    """State of a data set.

    Parameters
    ----------
    folder
        Its folder.

    Returns
    -------
    dict
        The state.

    Raises
    ------
    InputError
        If the folder holds no data set of this format.
    """
    path = folder / STATE
    state = read_json_object(path, "the state of a data set")
    if state.get("format") != FORMAT:
        raise InputError(f"{path}: format", repr(state.get("format")), repr(FORMAT))
    return state


def begin(recipe: Recipe, recipe_file: Path, folder: Path) -> Layout:
    """Begin a data set, or continue one of the same recipe and versions.

    Parameters
    ----------
    recipe
        The recipe.
    recipe_file
        Its file, which is copied.
    folder
        Folder of the data set: new, empty, or of the same recipe.

    Returns
    -------
    Layout
        Its files.

    Raises
    ------
    InputError
        If the folder holds anything else, another recipe, or pictures of other versions.
    """
    layout, path = Layout(folder), folder / STATE
    digest, installed = recipe.digest(recipe_file.parent), versions()
    content = {"format": FORMAT, "recipe": digest, "boxes": recipe.boxes, "versions": installed}
    if path.exists():
        state = read_state(folder)
        if state["recipe"] != digest:
            hint = "Name another folder, or use the recipe.toml in that folder."
            raise InputError(
                folder, f"a data set begun with another recipe than {recipe_file}", "the same recipe", hint
            )
        other = [
            f"{name} {state['versions'].get(name)} (not {mine})"
            for name, mine in installed.items()
            if state["versions"].get(name) != mine
        ]
        if other:
            hint = "Install those versions, or name another folder."
            raise InputError(folder, f"a data set begun with {', '.join(other)}", "the versions of this program", hint)
    elif folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        content_kind = "a folder with other files" if folder.is_dir() else "a file"
        raise InputError(folder, content_kind, "a new or empty folder, or a data set", "Name another one.")
    folder.mkdir(parents=True, exist_ok=True)
    if recipe_file.resolve() != (folder / "recipe.toml").resolve():
        with replacing(folder / "recipe.toml") as temporary:
            shutil.copyfile(recipe_file, temporary)
    write_json(path, content)
    return layout


def write_index(layout: Layout, records: Sequence[dict[str, Any]]) -> None:
    """Write the index: one row for each picture that passes its checks.

    It is index.csv, and index.parquet where the package arro3-io is installed.

    Parameters
    ----------
    layout
        Files of the data set.
    records
        Records of the pictures, in the order of the rows.
    """
    rows = [{"picture": number, **record} for number, record in enumerate(records)]
    with (
        replacing(layout.folder / INDEX) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as stream,
    ):
        writer = csv.DictWriter(stream, _COLUMNS, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    try:
        from arro3.core import Array, DataType, Table
        from arro3.io import write_parquet
    except ImportError:
        return
    kinds = {name: DataType.string() for name in _COLUMNS}
    kinds |= {name: DataType.int64() for name in WHOLE_NUMBERS} | {name: DataType.float64() for name in FRACTIONS}
    table = Table.from_pydict({name: Array([row[name] for row in rows], type=kinds[name]) for name in _COLUMNS})
    with replacing((layout.folder / INDEX).with_suffix(".parquet")) as temporary:
        write_parquet(table, temporary)
