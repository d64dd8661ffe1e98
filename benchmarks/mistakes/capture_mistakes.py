"""A copy of a capture that mistakes are made in, and the list of all mistakes.

A mistake takes a ``Draft`` and a random generator, changes files and manifest, and raises ``Unsuitable`` where the
capture has nothing to make it with. ``expected`` : a pattern that a suspicion (or a refusal) that names it matches.
"""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

__all__ = ["MISTAKES", "Draft", "Mistake", "Unsuitable", "frame_kinds", "mistake"]


class Unsuitable(Exception):
    """The capture has nothing to make this mistake with."""


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k} = {_value(v)}" for k, v in value.items()) + "}"
    return repr(value) if not isinstance(value, str) else '"' + value.replace('"', "'") + '"'


def _toml(data: dict[str, Any]) -> str:
    plain = {k: v for k, v in data.items() if not isinstance(v, (dict, list)) or (v and not _tables(v))}
    lines = [f"{k} = {_value(v)}" for k, v in plain.items() if not isinstance(v, dict)]
    for key, value in data.items():
        for table in [value] if isinstance(value, dict) else value if _tables(value) else []:
            header = f"[{key}]" if isinstance(value, dict) else f"[[{key}]]"
            lines += ["", header, *(f"{k} = {_value(v)}" for k, v in table.items())]
    return "\n".join(lines) + "\n"


def _tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict)


class Draft:
    """A copy of a capture that may be changed. others : further sound captures, of other views."""

    def __init__(self, source: Path, folder: Path, others: tuple[Path, ...] = ()) -> None:
        shutil.copytree(source, folder)
        for path in folder.rglob("*"):
            path.chmod(0o755 if path.is_dir() else 0o644)
        folder.chmod(0o755)
        self.folder, self.others = folder, others
        self.manifest: dict[str, Any] = tomllib.loads((folder / "capture.toml").read_text(encoding="utf-8"))

    def save(self) -> None:
        (self.folder / "capture.toml").write_text(_toml(self.manifest), encoding="utf-8")

    def tables(self, *kinds: str) -> list[dict[str, Any]]:
        """Tables of the kinds, in order; Unsuitable where there is none."""
        results = [t for kind in kinds for t in self.manifest.get(kind, []) if isinstance(t, dict)]
        if not results:
            raise Unsuitable
        return results

    def two(self, kind: str, rng: np.random.Generator, apart: int = 2) -> tuple[dict, dict]:
        """Two tables of a kind, in the order of their wavelengths at least ``apart`` places from each other."""
        tables = sorted(self.tables(kind), key=lambda t: str(t.get("id", t.get("band", t["exposure_s"]))))
        if kind == "dark":
            tables.sort(key=lambda t: t["exposure_s"])
        if len(tables) <= apart:
            raise Unsuitable
        first = int(rng.integers(len(tables) - apart))
        second = int(rng.integers(first + apart, len(tables)))
        return tables[first], tables[second]

    def image(self, path: str) -> NDArray[np.uint16]:
        return np.asarray(tifffile.imread(self.folder / path))

    def put(self, path: str, counts: NDArray) -> None:
        full = 2 ** self.manifest["camera"]["bit_depth"] - 1
        tifffile.imwrite(self.folder / path, np.clip(np.rint(counts), 0, full).astype(np.uint16))

    def change(self, change: Callable[[NDArray[np.float64]], NDArray], *kinds: str) -> None:
        """Every frame of the kinds through ``change``."""
        for table in self.tables(*kinds):
            for path in table["frames"]:
                self.put(path, change(self.image(path).astype(float)))

    def swap(self, first_table: dict, other: dict) -> None:
        """The contents of two tables' frames, exchanged as far as both have repeats."""
        for a, b in zip(first_table["frames"], other["frames"], strict=False):
            first, second = self.image(a), self.image(b)
            self.put(a, second)
            self.put(b, first)

    def columns(self, reference: str | None) -> tuple[Path, int]:
        """File and column number of a reference."""
        if reference is None:
            raise Unsuitable
        name, column = reference.rsplit(":", 1)
        header = (self.folder / name).read_text(encoding="utf-8").splitlines()[0].split(",")
        return self.folder / name, [h.strip() for h in header].index(column)

    def spectrum(self, reference: str | None, change: Callable[[NDArray], NDArray]) -> None:
        """A column's values through ``change``."""
        path, column = self.columns(reference)
        table, header = np.loadtxt(path, delimiter=",", skiprows=1), path.read_text().splitlines()[0]
        table[:, column] = change(table[:, column])
        np.savetxt(path, table, "%.8g", ",", header=header, comments="")

    def rows(self, reference: str | None, change: Callable[[NDArray], NDArray]) -> None:
        """A whole table (n, columns) through ``change``."""
        path, _ = self.columns(reference)
        table, header = np.loadtxt(path, delimiter=",", skiprows=1), path.read_text().splitlines()[0]
        np.savetxt(path, change(table), "%.8g", ",", header=header, comments="")

    def points(self, change: Callable[[NDArray], NDArray]) -> None:
        """x, y, z, u, v (n, 5) of points.csv through ``change``."""
        if "geometry" not in self.manifest:
            raise Unsuitable
        path = self.folder / self.manifest["geometry"]["points"]
        lines = path.read_text().splitlines()
        cells = [line.split(",") for line in lines[1:]]
        table = change(np.array([[float(x) for x in row[1:]] for row in cells]))
        rows = [",".join([row[0], *(f"{x:.4f}" for x in new)]) for row, new in zip(cells, table, strict=False)]
        path.write_text("\n".join([lines[0], *rows]) + "\n")


@dataclass(frozen=True)
class Mistake:
    name: str
    make: Callable[[Draft, np.random.Generator], None]
    expected: str


MISTAKES: list[Mistake] = []


def mistake(name: str, expected: str) -> Callable:
    def keep(make: Callable[[Draft, np.random.Generator], None]) -> Callable:
        MISTAKES.append(Mistake(name, make, expected))
        return make

    return keep


def frame_kinds(draft: Draft, darks: bool = True) -> list[str]:
    """Kinds of tables with frames that the capture has, with or without dark frames."""
    kinds = [kind for kind in ("band", "bracket", "flat", "reference") if draft.manifest.get(kind)]
    return [*kinds, *(["dark"] if darks and isinstance(draft.manifest.get("dark"), list) else [])]
