"""A data set on disk: its index, and its pictures read on demand."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from cboxlab.rendering.model import Model, load_model
from cboxlab.utils.arguments import (
    described,
    require_type,
    require_word,
    required_folder,
    required_path,
    required_whole_number,
)
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import path_inside
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.input_files import read_json_object, require_regular_file
from cboxlab.utils.limits import require_size
from cboxlab.utils.numbers import number_of, whole_number_of
from numpy.typing import NDArray

from .formats import COPY_ENDINGS, open_picture, write_copy
from .layout import FRACTIONS, INDEX, WHOLE_NUMBERS, file_hash, read_state

__all__ = ["Arrays", "Dataset", "open_dataset"]

#: Bytes of an index: 700,000 pictures have as many.
_MOST_BYTES = 2**27
#: Columns of the index with texts that are read.
_TEXTS = ("camera", "part", "file", "model", "sha256")
#: Name of a camera, which becomes part of names of files.
_NAME = re.compile(r"[\w-]+")
#: Parts of a data set.
PARTS = ("train", "validation", "test")


@dataclass(frozen=True, eq=False, repr=False)
class Dataset(FrozenMappings):
    """Pictures of a data set, read on demand.

    Examples
    --------
    >>> import cboxlab
    >>> boxes = cboxlab.open_dataset("boxes")  # doctest: +SKIP
    >>> boxes.part("train")[0]["radiance"].sel(wavelength=550.0).mean()  # doctest: +SKIP
    """

    #: Folder of the data set.
    folder: Path
    #: One row for each picture, as in index.csv.
    index: tuple[Mapping[str, Any], ...]

    def __len__(self) -> int:
        return len(self.index)

    def __repr__(self) -> str:
        counts = ", ".join(f"{sum(row['part'] == name for row in self.index)} {name}" for name in PARTS)
        return f"{len(self)} pictures in {self.folder}: {counts}"

    def __getitem__(self, number: int) -> xr.Dataset:
        """Picture of a row of the index; its values are read on demand."""
        return open_picture(self._path(self._row(number), "file"))

    def __iter__(self) -> Iterator[xr.Dataset]:
        return (self[number] for number in range(len(self)))

    def part(self, name: str) -> Dataset:
        """Pictures of one part.

        Parameters
        ----------
        name
            "train", "validation" or "test".

        Returns
        -------
        Dataset
            The pictures.

        Raises
        ------
        InputError
            For another name.
        """
        require_word("part", name, PARTS)
        return self.where(part=name)

    def where(self, **columns: Any) -> Dataset:
        """Pictures whose columns of the index have some values.

        Parameters
        ----------
        **columns
            Value by column, such as ``camera="left"``.

        Returns
        -------
        Dataset
            The pictures.

        Raises
        ------
        InputError
            For a column that the index lacks, and a value that is neither text nor number.
        """
        for key, value in columns.items():
            if self.index:
                require_word("column", key, self.index[0])
            require_type(key, value, (str, Real), "a text or a number")
        rows = tuple(row for row in self.index if all(row.get(key) == value for key, value in columns.items()))
        return Dataset(self.folder, rows)

    def model(self, number: int) -> Model:
        """Model of a picture's box.

        Parameters
        ----------
        number
            Row of the index.

        Returns
        -------
        Model
            Scene and effects.

        Raises
        ------
        InputError
            If there is no such row, or its model cannot be read.
        """
        return load_model(self._path(self._row(number), "model"))

    def drawn_values(self, number: int) -> dict[str, Any]:
        """Values that were drawn for a picture's box.

        Parameters
        ----------
        number
            Row of the index.

        Returns
        -------
        dict
            Content of box.json.

        Raises
        ------
        InputError
            If there is no such row, or its box.json cannot be read.
        """
        path = self._path(self._row(number), "model").with_name("box.json")
        return read_json_object(path, "the drawn values of a box")

    def arrays(self, *names: str) -> Arrays:
        """Pictures as NumPy arrays, for a loader of PyTorch and the like.

        Parameters
        ----------
        *names
            Variables, such as "radiance" and "albedo".

        Returns
        -------
        Arrays
            A sequence of dictionaries.

        Raises
        ------
        InputError
            If the pictures lack a variable.
        """
        if self.index:
            with self[0] as first:
                for name in names:
                    require_word("variable", name, map(str, first.data_vars))
        return Arrays(self, names)

    def export(self, folder: str | Path, ending: str = ".hdr") -> list[Path]:
        """Write the radiance of every picture in another format.

        Parameters
        ----------
        folder
            Folder of the files.
        ending
            .hdr for ENVI, .exr for spectral OpenEXR, .mat for HDF5 as benchmarks of spectral recovery read it,
            .png for previews.

        Returns
        -------
        list of Path
            The files.

        Raises
        ------
        InputError
            For another ending, and for a file in place of the folder.
        """
        target, files = required_folder("folder", folder), list[Path]()
        require_word("ending", ending, COPY_ENDINGS.values())
        target.mkdir(parents=True, exist_ok=True)
        for row, number in zip(self.index, range(len(self)), strict=True):
            with self[number] as picture:
                path = target / f"{row['box']:06d}-{row['camera']}{ending}"
                write_copy(path, picture)
            files.append(path)
        return files

    def _row(self, number: int) -> Mapping[str, Any]:
        """Row of the index; negative numbers count from the end."""
        rows = len(self.index)
        if not rows:
            raise InputError("picture", described(number), "a data set with pictures")
        return self.index[required_whole_number("picture", number, -rows, rows - 1)]

    def _path(self, row: Mapping[str, Any], column: str) -> Path:
        """A file that a row names, below the folder."""
        return path_inside(self.folder, row[column], f"{self.folder / INDEX}: {column}")

    def damaged(self) -> list[str]:
        """Files whose checksum is not that of the index.

        Returns
        -------
        list of str
            Paths in the data set; empty if all are whole.

        Raises
        ------
        InputError
            For a path that leaves the folder.
        """

        def intact(row: Mapping[str, Any]) -> bool:
            path = self._path(row, "file")
            return path.is_file() and file_hash(path) == row["sha256"]

        return [row["file"] for row in self.index if not intact(row)]


@dataclass(frozen=True, eq=False)
class Arrays(Sequence[Mapping[str, NDArray[np.generic]]]):
    """Pictures as NumPy arrays, with the length and the indices that loaders ask for."""

    #: The pictures.
    dataset: Dataset
    #: Variables of each.
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.dataset)

    def __iter__(self) -> Iterator[Mapping[str, NDArray[np.generic]]]:
        return (self[number] for number in range(len(self)))

    def __getitem__(self, number: Any) -> Any:
        """Arrays of one picture by variable."""
        with self.dataset[number] as picture:
            try:
                return {name: picture[name].values for name in self.names}
            except (OSError, RuntimeError, ValueError) as error:  # values are read here: see ``damaged``
                file = self.dataset.index[number]["file"]
                fault = f"values that cannot be read ({type(error).__name__}: {error})"
                raise InputError(self.dataset.folder / file, fault, "a picture as cbox wrote it") from None


def open_dataset(folder: str | Path) -> Dataset:
    """Open a data set that ``cbox dataset`` wrote.

    Parameters
    ----------
    folder
        Its folder.

    Returns
    -------
    Dataset
        The pictures that passed their checks.

    Raises
    ------
    InputError
        If the folder holds no data set, or one without an index.

    Examples
    --------
    >>> import cboxlab
    >>> boxes = cboxlab.open_dataset("boxes")  # doctest: +SKIP
    >>> len(boxes), boxes.index[0]["part"]  # doctest: +SKIP
    """
    path = required_path("folder", folder, "the folder of a data set")
    read_state(path)
    hint = "The run has not ended. Repeat the command that began it."
    require_regular_file(path / INDEX, "the index of a data set", hint)
    require_size(path / INDEX, (path / INDEX).stat().st_size, _MOST_BYTES, "bytes")
    try:
        with (path / INDEX).open(encoding="utf-8", newline="") as stream:
            rows = tuple(_row(path / INDEX, row) for row in csv.DictReader(stream))
    except (UnicodeDecodeError, csv.Error, OSError) as error:
        raise InputError(path / INDEX, f"a table that cannot be read ({error})", "an index that cbox wrote") from None
    return Dataset(path, rows)


def _row(path: Path, row: Mapping[str, str]) -> Mapping[str, Any]:
    """Row of the index with its numbers."""
    try:
        numbers: dict[str, Any] = {key: whole_number_of(row[key]) for key in WHOLE_NUMBERS}
        numbers.update({key: number_of(row[key]) for key in FRACTIONS})
    except (KeyError, AttributeError) as error:
        raise InputError(path, f"a row that cannot be read ({error})", "an index that cbox wrote") from None
    for key in (*WHOLE_NUMBERS, *FRACTIONS):
        if numbers[key] is None or (numbers[key] != numbers[key] and row[key] != "nan"):
            raise InputError(path, f"{key} '{row[key][:40]}'", "a number")
    for key in _TEXTS:
        if not row.get(key):
            raise InputError(path, f"a row without {key}", "an index that cbox wrote")
    if not _NAME.fullmatch(row["camera"]):
        raise InputError(path, f"camera '{row['camera'][:40]}'", "a name of letters, digits, - and _")
    return {**row, **numbers}
