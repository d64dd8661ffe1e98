"""Label image of a capture, from the shapes that a person draws in its photograph."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.calibration.capture import Label, load_capture
from cboxlab.calibration.colour import chart_outlines
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from matplotlib.path import Path as Outline
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import binary_erosion

from ...report.viewer import encoded
from .photographs import CaptureInView, Photograph, add_table, load_photograph

__all__ = ["Labelling"]

#: Label image of a capture that states none.
_IMAGE = "labels.png"

#: Names of the labels of a capture that states none.
_NAMES = "labels.csv"

#: Largest label of an 8-bit image.
_LARGEST_LABEL = 255

#: Most shapes: a request has at most 64 kB.
_MOST_SHAPES = 500

#: Most corners of a shape.
_MOST_CORNERS = 200

#: Most letters of a name.
_MOST_LETTERS = 60


@dataclass(frozen=True)
class _Shape:
    """Polygon whose pixels get a label."""

    label: int
    #: (u, v) corners, px.
    corners: tuple[tuple[float, float], ...]


class Labelling:
    """Labels of captures below a folder.

    Parameters
    ----------
    root
        Folder below which captures are opened.
    """

    def __init__(self, root: Path) -> None:
        self._photographs = CaptureInView(root, lambda name: load_photograph(root, name, with_scene=False))

    def picture(self, capture: str) -> dict[str, Any]:
        """Photograph of a capture, its labels, and their names.

        Parameters
        ----------
        capture
            Folder of the capture, below the root folder.

        Returns
        -------
        dict
            Ready for JSON; ``labels`` is null without a label image.

        Raises
        ------
        InputError
            If the capture is faulty, outside the root folder, or reduced.
        """
        photograph = self._photographs.of(capture, again=True)
        height, width = photograph.values.shape
        loaded = load_capture(photograph.folder)
        table = loaded.manifest.labels
        names = [] if table is None else loaded.label_names()
        return {
            "width": width,
            "height": height,
            "photograph": encoded(photograph.values),
            "labels": None if table is None or table.image is None else encoded(loaded.labels()),
            "names": [{"label": row.label, "name": row.name, "column": row.column or ""} for row in names],
        }

    def chart(self, capture: str) -> dict[str, Any]:
        """Patches of a ColorChecker in the photograph, as shapes.

        Parameters
        ----------
        capture
            Folder of the capture.

        Returns
        -------
        dict
            Ready for JSON: ``shapes`` with labels 1 to 24.

        Raises
        ------
        InputError
            As of ``chart_outlines``.
        """
        calibration = self._photographs.of(capture).calibration
        outlines = chart_outlines(calibration.capture, calibration.bands)
        return {"shapes": [{"label": n, "corners": corners.tolist()} for n, corners in enumerate(outlines, 1)]}

    def count(self, capture: str, shapes: Sequence[Any], base: bool) -> dict[str, Any]:
        """Pixels of each label, and those without a rim of 4 px, which calibration uses.

        Parameters
        ----------
        capture
            Folder of the capture.
        shapes
            Records with ``label`` (0 for none) and ``corners``, later ones over earlier ones.
        base
            Whether they are drawn over the capture's own labels.

        Returns
        -------
        dict
            Ready for JSON.

        Raises
        ------
        InputError
            For faulty shapes.
        """
        image = self._label_image(self._photographs.of(capture), shapes, base)
        numbers = [int(n) for n in np.unique(image) if n]
        return {
            "counts": [
                {
                    "label": n,
                    "pixels": int(np.sum(image == n)),
                    "inside": int(binary_erosion(image == n, iterations=4).sum()),
                }
                for n in numbers
            ]
        }

    def write(
        self, capture: str, shapes: Sequence[Any], names: Sequence[Any], base: bool, replace: bool
    ) -> dict[str, Any]:
        """Write label image and names, and name them in a capture.toml without labels.

        Parameters
        ----------
        capture, shapes, base
            As of ``count``.
        names
            Records with ``label``, ``name`` and ``column``, one for each label that is drawn.
        replace
            Whether existing files may be replaced.

        Returns
        -------
        dict
            Paths of the files, the lines that capture.toml needs, and whether they were added there. Without
            ``replace`` the list ``exists`` of files that exist, and nothing is written.

        Raises
        ------
        InputError
            As of ``count``, for drawn labels without a name, and if no pixel has a label.
        """
        photograph = self._photographs.of(capture)
        image = self._label_image(photograph, shapes, base)
        rows = _rows(names)
        used = {int(n) for n in np.unique(image) if n}
        if not used:
            raise InputError("labels", "no pixel with a label", "at least one shape")
        of_shapes = {shape.label for shape in _shapes(shapes) if shape.label in used}
        if nameless := sorted(of_shapes - {row.label for row in rows}):
            raise InputError("labels", f"no name for {', '.join(map(str, nameless))}", "a name for each label")
        table = load_capture(photograph.folder).manifest.labels
        image_name = table.image if table is not None and table.image is not None else _IMAGE
        names_name = table.names if table is not None else _NAMES
        paths = [photograph.folder / image_name, photograph.folder / names_name]
        if exists := [str(path) for path in paths if path.exists() or path.is_symlink()]:
            if not replace:
                return {"exists": exists}
            if any(path.is_symlink() for path in paths):
                raise InputError(exists[0], "a link", "a file", "Move it away to write another one.")
        text = io.StringIO()
        lines = csv.writer(text, lineterminator="\n")
        lines.writerow(("label", "name", "column"))
        lines.writerows((row.label, row.name, row.column or "") for row in rows if row.label in used)
        with replacing(paths[0]) as temporary:
            Image.fromarray(image).save(temporary, format="PNG")
        with replacing(paths[1]) as temporary:
            temporary.write_text(text.getvalue(), encoding="utf-8")
        needs = f'[labels]\nimage = "{image_name}"\nnames = "{names_name}"'
        added = add_table(photograph.folder / "capture.toml", "labels", needs)
        is_named = table is not None and table.image is not None
        return {"paths": [str(path) for path in paths], "lines": "" if is_named else needs, "added": added}

    def _label_image(self, photograph: Photograph, records: Sequence[Any], base: bool) -> NDArray[np.uint8]:
        """(y, x) label of each pixel whose centre is in a shape, or of the capture's own labels."""
        shape = photograph.values.shape
        image: NDArray[np.uint8] = np.zeros(shape, np.uint8)
        if base:
            loaded = load_capture(photograph.folder)
            if loaded.manifest.labels is not None and loaded.manifest.labels.image is not None:
                image = loaded.labels().copy()
        v, u = np.mgrid[: shape[0], : shape[1]]
        centres = np.stack([u.ravel(), v.ravel()], axis=1)
        for area in _shapes(records):
            inside = Outline(area.corners, closed=False).contains_points(centres).reshape(shape)
            image[inside] = area.label
        return image


def _shapes(records: Sequence[Any]) -> list[_Shape]:
    """Shapes of the page; InputError for faulty ones."""
    if len(records) > _MOST_SHAPES:
        raise InputError("shapes", f"{len(records)}", f"at most {_MOST_SHAPES}")
    shapes = []
    for record in records:
        label = record.get("label") if isinstance(record, Mapping) else None
        corners = record.get("corners") if isinstance(record, Mapping) else None
        if not isinstance(label, int) or isinstance(label, bool) or not 0 <= label <= _LARGEST_LABEL:
            raise InputError("shapes", repr(record)[:80], f"a label from 0 to {_LARGEST_LABEL}")
        if not isinstance(corners, list) or not 3 <= len(corners) <= _MOST_CORNERS or not all(map(_is_place, corners)):
            raise InputError("shapes", repr(corners)[:80], f"3 to {_MOST_CORNERS} corners u, v in px")
        shapes.append(_Shape(label, tuple((float(u), float(v)) for u, v in corners)))
    return shapes


def _is_place(corner: object) -> bool:
    """Whether a JSON value is a position in a picture."""
    return (
        isinstance(corner, list)
        and len(corner) == 2
        and all(isinstance(x, int | float) and not isinstance(x, bool) and abs(x) < 1e6 for x in corner)
    )


def _rows(records: Sequence[Any]) -> list[Label]:
    """Names of labels of the page; InputError for faulty ones."""
    rows: dict[int, Label] = {}
    for record in records:
        label, name, column = (
            [record.get(key) for key in ("label", "name", "column")] if isinstance(record, Mapping) else [None] * 3
        )
        if not isinstance(label, int) or isinstance(label, bool) or not 1 <= label <= _LARGEST_LABEL or label in rows:
            raise InputError("labels", repr(record)[:80], f"numbers from 1 to {_LARGEST_LABEL}, each once")
        if not isinstance(name, str) or not isinstance(column, str) or max(len(name), len(column)) > _MOST_LETTERS:
            raise InputError(
                f"labels, {label}", repr(record)[:80], f"a name and a column of up to {_MOST_LETTERS} letters"
            )
        if not name.strip() or not name.isprintable() or not column.isprintable():
            raise InputError(f"labels, {label}", repr(name)[:80], "a name of printable letters")
        rows[label] = Label(label, name.strip(), column.strip() or None)
    return list(rows.values())
