"""Mistakes in frames and points of a capture."""

from __future__ import annotations

import shutil
from collections.abc import Callable

import numpy as np
import tifffile
from capture_mistakes import MISTAKES, Draft, Mistake, Unsuitable, frame_kinds, mistake
from numpy.typing import NDArray

# --- frames --------------------------------------------------------------------------------------------------------


def _exchanged(kind: str) -> Callable[[Draft, np.random.Generator], None]:
    return lambda d, rng: d.swap(*d.two(kind, rng))


for _name, _kind, _pattern in (
    ("two bands' frames exchanged", "band", r"exchanged|another band|does not suit"),
    ("two bands' flats exchanged", "flat", r"flat"),
    ("two bands' references exchanged", "reference", r"reference"),
    ("two exposures' darks exchanged", "dark", r"dark"),
):
    MISTAKES.append(Mistake(_name, _exchanged(_kind), _pattern))


@mistake("a band's file names exchanged in the manifest", r"another band|exchanged")
def _(d: Draft, rng: np.random.Generator) -> None:
    a, b = d.two("band", rng)
    a["frames"], b["frames"] = b["frames"], a["frames"]


@mistake("a repeat shows another band", r"repeat")
def _(d: Draft, rng: np.random.Generator) -> None:
    a, b = d.two("band", rng)
    if len(a["frames"]) < 2:
        raise Unsuitable
    d.put(a["frames"][-1], d.image(b["frames"][0]))


@mistake("the same frame as two repeats", r"same|twice")
def _(d: Draft, rng: np.random.Generator) -> None:
    a, _ = d.two("band", rng)
    if len(a["frames"]) < 2:
        raise Unsuitable
    d.put(a["frames"][1], d.image(a["frames"][0]))


@mistake("the same frames for two bands", r"same|twice")
def _(d: Draft, rng: np.random.Generator) -> None:
    a, b = d.two("band", rng)
    for first, other in zip(a["frames"], b["frames"], strict=False):
        d.put(first, d.image(other))


@mistake("rows with another noise", r"of a row share")
def _(d: Draft, rng: np.random.Generator) -> None:
    for table in d.tables("band"):
        for path in table["frames"]:
            values = d.image(path).astype(float)
            d.put(path, values + rng.normal(0, 2, (values.shape[0], 1)))


@mistake("a dark repeat of another exposure", r"dark|same")
def _(d: Draft, rng: np.random.Generator) -> None:
    tables = sorted(d.tables("dark"), key=lambda t: t["exposure_s"])
    if len(tables[0]["frames"]) < 2 or len(tables) < 3:
        raise Unsuitable
    noise = rng.normal(0, 0.8, d.image(tables[0]["frames"][0]).shape)
    d.put(tables[1]["frames"][-1], d.image(tables[-1]["frames"][0]) + noise)


@mistake("a dark taken with the lens cap off", r"dark")
def _(d: Draft, rng: np.random.Generator) -> None:
    table = rng.choice(d.tables("dark"))  # type: ignore[arg-type]
    picture = d.image(d.tables("band")[0]["frames"][0]).astype(float)
    for path in table["frames"]:
        values = d.image(path).astype(float)
        d.put(path, values + 0.02 * (picture - picture.min()))


@mistake("a band's frames taken with the lens cap on", r"no light")
def _(d: Draft, rng: np.random.Generator) -> None:
    table, dark = rng.choice(d.tables("band")), d.tables("dark")[0]  # type: ignore[arg-type]
    for path in table["frames"]:
        values = d.image(dark["frames"][0]).astype(float)
        d.put(path, values + np.rint(rng.normal(0, 0.6, values.shape)))


@mistake("a flat that shows the scene", r"flat")
def _(d: Draft, rng: np.random.Generator) -> None:
    table = rng.choice(d.tables("flat"))  # type: ignore[arg-type]
    band = next(b for b in d.tables("band") if b["id"] == table["band"])
    for path, other in zip(table["frames"], band["frames"], strict=False):
        values = d.image(other).astype(float)
        d.put(path, values + np.rint(rng.normal(0, 3, values.shape)))


def _turned(turn: Callable[[NDArray], NDArray], *kinds: str) -> Callable[[Draft, np.random.Generator], None]:
    def make(d: Draft, rng: np.random.Generator) -> None:
        if "geometry" not in d.manifest and not d.manifest.get("flat") and "labels" not in d.manifest:
            raise Unsuitable
        camera = d.manifest["camera"]
        blank = np.zeros((camera["height_px"], camera["width_px"]))
        if turn(blank).shape != blank.shape:
            raise Unsuitable
        d.change(turn, *(kinds or frame_kinds(d)))

    return make


for _name, _make in (
    ("all frames mirrored left to right", _turned(lambda y: y[:, ::-1])),
    ("all frames upside down", _turned(lambda y: y[::-1])),
    ("all frames turned by 180 degrees", _turned(lambda y: y[::-1, ::-1])),
    ("all frames with rows and columns exchanged", _turned(lambda y: y.T)),
    ("the photographs mirrored, not the flats", _turned(lambda y: y[:, ::-1], "band")),
):
    MISTAKES.append(Mistake(_name, _make, r"mirrored|upside|turned|rows and columns"))


@mistake("one band's frames mirrored", r"mirrored")
def _(d: Draft, rng: np.random.Generator) -> None:
    table = rng.choice(d.tables("band"))  # type: ignore[arg-type]
    for path in table["frames"]:
        d.put(path, d.image(path)[:, ::-1])


@mistake("one band's frames moved by 3 px", r"moved")
def _(d: Draft, rng: np.random.Generator) -> None:
    table = rng.choice(d.tables("band"))  # type: ignore[arg-type]
    for path in table["frames"]:
        d.put(path, np.roll(d.image(path), 3, axis=1))


@mistake("one band's frames of another capture", r"moved|another|does not suit|repeat")
def _(d: Draft, rng: np.random.Generator) -> None:
    if not d.others:
        raise Unsuitable
    other = Draft(d.others[0], d.folder.parent / "another")
    table = rng.choice(d.tables("band"))  # type: ignore[arg-type]
    like = next((b for b in other.tables("band") if b["id"] == table["id"]), None)
    if like is None or other.image(like["frames"][0]).shape != d.image(table["frames"][0]).shape:
        raise Unsuitable
    for path, theirs in zip(table["frames"], like["frames"], strict=False):
        d.put(path, other.image(theirs))


def _changed(change: Callable[[NDArray, float], NDArray], *kinds: str) -> Callable[[Draft, np.random.Generator], None]:
    def make(d: Draft, rng: np.random.Generator) -> None:
        full = float(2 ** d.manifest["camera"]["bit_depth"] - 1)
        d.change(lambda y: change(y, full), *(kinds or frame_kinds(d)))

    return make


for _name, _make, _pattern in (
    ("frames clipped at half of full scale", _changed(lambda y, full: np.minimum(y, full // 2)), r"full scale"),
    ("frames reduced to 8 bits", _changed(lambda y, full: np.rint(y / full * 255) * full / 255), r"gaps|counts"),
    ("frames stored as 8 bits", _changed(lambda y, full: y / full * 255), r"full scale|gaps|gain"),
    ("frames gamma-encoded", _changed(lambda y, full: full * (y / full) ** (1 / 2.2)), r"gamma"),
    ("photographs gamma-encoded", _changed(lambda y, full: full * (y / full) ** (1 / 2.2), "band"), r"gamma"),
    (
        "byte order wrong",
        lambda d, rng: [
            tifffile.imwrite(d.folder / p, d.image(p).byteswap()) for t in d.tables("band") for p in t["frames"]
        ],
        r"count of|bit_depth|gaps",
    ),
):
    MISTAKES.append(Mistake(_name, _make, _pattern))  # type: ignore[arg-type]


@mistake("the dark already subtracted", r"dark")
def _(d: Draft, rng: np.random.Generator) -> None:
    darks = {t["exposure_s"]: np.mean([d.image(p) for p in t["frames"]], axis=0) for t in d.tables("dark")}
    level = np.median(next(iter(darks.values())))
    if level < 5:
        raise Unsuitable
    for table in d.tables(*frame_kinds(d, darks=False)):
        darks_of_exposure = darks.get(table["exposure_s"], level)
        for path in table["frames"]:
            d.put(path, d.image(path) - darks_of_exposure)


@mistake("photographs smoothed", r"independent|smooth|noise|repeat|flats")
def _(d: Draft, rng: np.random.Generator) -> None:
    for table in d.tables("band"):
        for path in table["frames"]:
            y = d.image(path).astype(float)
            d.put(path, sum(np.roll(y, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)) / 9)


@mistake("a dead column", r"dead columns")
def _(d: Draft, rng: np.random.Generator) -> None:
    column = int(rng.integers(1, d.manifest["camera"]["width_px"] - 1))

    def dead(y: NDArray) -> NDArray:
        y[:, column] = 0.0
        return y

    d.change(dead, *frame_kinds(d))


@mistake("two hot rows", r"hot rows")
def _(d: Draft, rng: np.random.Generator) -> None:
    rows, excess = rng.integers(1, d.manifest["camera"]["height_px"] - 1, 2), float(rng.uniform(60, 600))

    def hot(y: NDArray) -> NDArray:
        y[rows] += excess
        return y

    d.change(hot, *frame_kinds(d))


# --- points --------------------------------------------------------------------------------------------------------


def _surveyed(
    change: Callable[[NDArray, float, float], NDArray],
) -> Callable[[Draft, np.random.Generator], None]:
    def make(d: Draft, rng: np.random.Generator) -> None:
        camera = d.manifest["camera"]
        d.points(lambda t: change(t.copy(), camera["width_px"], camera["height_px"]))

    return make


def _v_up(t: NDArray, width: float, height: float) -> NDArray:
    t[:, 4] = height - 1 - t[:, 4]
    return t


def _scaled(column: slice, factor: float) -> Callable[[NDArray, float, float], NDArray]:
    def change(t: NDArray, width: float, height: float) -> NDArray:
        t[:, column] *= factor
        return t

    return change


def _one_wrong(t: NDArray, width: float, height: float) -> NDArray:
    t[3, 3] += 0.15 * width
    return t


for _name, _make, _pattern in (
    ("points with u and v exchanged", _surveyed(lambda t, w, h: t[:, [0, 1, 2, 4, 3]]), r"u and v|axes"),
    ("points with v upwards", _surveyed(_v_up), r"v runs|axes"),
    ("points in cm", _surveyed(_scaled(slice(0, 3), 0.1)), r"in cm"),
    ("points with x and z exchanged", _surveyed(lambda t, w, h: t[:, [2, 1, 0, 3, 4]]), r"x and z|axes"),
    ("points of a picture twice as large", _surveyed(_scaled(slice(3, 5), 2.0)), r"points"),
    ("points of a picture half as large", _surveyed(_scaled(slice(3, 5), 0.5)), r"points"),
    ("one point mistaken", _surveyed(_one_wrong), r"points are wrong"),
):
    MISTAKES.append(Mistake(_name, _make, _pattern))


@mistake("points of another capture", r"points")
def _(d: Draft, rng: np.random.Generator) -> None:
    if "geometry" not in d.manifest or not d.others:
        raise Unsuitable
    other = Draft(d.others[-1], d.folder.parent / "another")
    if "geometry" not in other.manifest:
        raise Unsuitable
    shutil.copy(other.folder / other.manifest["geometry"]["points"], d.folder / d.manifest["geometry"]["points"])
