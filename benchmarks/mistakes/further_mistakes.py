"""Further mistakes in captures: processed frames, tables of the wrong quantity, mistyped numbers."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO

import numpy as np
from capture_mistakes import MISTAKES, Draft, Mistake, Unsuitable, mistake
from manifest_mistakes import efficiency_of, filters_of, lamp_of, lens_of, sphere_of
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import zoom

# --- frames --------------------------------------------------------------------------------------------------------


def _some(d: Draft, kind: str, rng: np.random.Generator) -> dict:
    return d.tables(kind)[int(rng.integers(len(d.tables(kind))))]


def _frames_of(d: Draft, table: dict, change: Callable[[NDArray[np.float64]], NDArray]) -> None:
    for path in table["frames"]:
        d.put(path, change(d.image(path).astype(float)))


def _binned(y: NDArray[np.float64]) -> NDArray[np.float64]:
    rows, columns = (n // 2 * 2 for n in y.shape)
    small = y[:rows, :columns].reshape(rows // 2, 2, columns // 2, 2).mean(axis=(1, 3))
    large = y.copy()
    large[:rows, :columns] = np.kron(small, np.ones((2, 2)))
    return large


def _zoomed(y: NDArray[np.float64]) -> NDArray[np.float64]:
    cut = [round(0.05 * n) for n in y.shape]
    inner = y[cut[0] : y.shape[0] - cut[0], cut[1] : y.shape[1] - cut[1]]
    return np.asarray(zoom(inner, np.divide(y.shape, inner.shape), order=1))


def _as_jpeg(y: NDArray[np.float64]) -> NDArray[np.float64]:
    buffer, top = BytesIO(), max(y.max(), 1.0)
    Image.fromarray(np.rint(255 * y / top).astype(np.uint8)).save(buffer, "JPEG", quality=85)
    return np.asarray(Image.open(buffer), float) / 255 * top


@mistake("photographs binned by two and enlarged again", r"neighbour|binned|noise|independent|smooth|flats")
def _(d: Draft, rng: np.random.Generator) -> None:
    d.change(_binned, "band")


@mistake("photographs cropped and enlarged by a tenth", r"points|moved|flats|noise|smooth|enlarged")
def _(d: Draft, rng: np.random.Generator) -> None:
    d.change(_zoomed, "band")


@mistake("photographs saved as JPEG in between", r"gaps|noise|smooth|flats|compress")
def _(d: Draft, rng: np.random.Generator) -> None:
    d.change(_as_jpeg, "band")


@mistake("each photograph stretched to full scale", r"dark|full scale|gain|noise|exposure|does not suit|gaps")
def _(d: Draft, rng: np.random.Generator) -> None:
    full = 2 ** d.manifest["camera"]["bit_depth"] - 1

    def stretched(y: NDArray[np.float64]) -> NDArray[np.float64]:
        return (y - y.min()) / max(np.ptp(y), 1.0) * full

    d.change(stretched, "band")


@mistake("one band averaged over two exposures", r"exposure|does not suit|noise|brighter|darker")
def _(d: Draft, rng: np.random.Generator) -> None:
    table, level = _some(d, "band", rng), np.median(d.image(d.tables("dark")[0]["frames"][0]))
    _frames_of(d, table, lambda y: level + 0.625 * (y - level))


@mistake("saturated flats", r"flat.*(saturat|full scale)|(saturat|full scale).*flat")
def _(d: Draft, rng: np.random.Generator) -> None:
    full = 2 ** d.manifest["camera"]["bit_depth"] - 1
    table = _some(d, "flat", rng)
    level = np.median(d.image(table["frames"][0]))
    _frames_of(d, table, lambda y: np.minimum(1.02 * full / level * y, full))


@mistake("photographs already divided by the flat", r"flat")
def _(d: Draft, rng: np.random.Generator) -> None:
    darks = d.tables("dark")
    level = np.median(d.image(darks[0]["frames"][0]))
    for table in d.tables("band"):
        flat = next((f for f in d.tables("flat") if f["band"] == table["id"]), None)
        if flat is None:
            raise Unsuitable
        shape = np.mean([d.image(p).astype(float) for p in flat["frames"]], axis=0) - level
        even = shape / shape.mean()
        _frames_of(d, table, lambda y, even=even: level + (y - level) / even)  # type: ignore[misc]


@mistake("photographs read from a region 4 px next to the flats'", r"flat|moved|region|points")
def _(d: Draft, rng: np.random.Generator) -> None:
    d.change(lambda y: np.roll(y, (4, 0), axis=(0, 1)), "band")


@mistake("darks of a warmer sensor", r"dark")
def _(d: Draft, rng: np.random.Generator) -> None:
    tables = sorted(d.tables("dark"), key=lambda t: t["exposure_s"])
    if len(tables) < 3:
        raise Unsuitable
    base = np.mean([d.image(p).astype(float) for p in tables[0]["frames"]], axis=0)
    for table in tables[len(tables) // 2 :]:
        mean = np.mean([d.image(p).astype(float) for p in table["frames"]], axis=0)
        extra = 4 * np.maximum(mean - base, 0)
        _frames_of(d, table, lambda y, extra=extra: y + extra)  # type: ignore[misc]


@mistake("a dark labelled with another exposure", r"dark")
def _(d: Draft, rng: np.random.Generator) -> None:
    tables = sorted(d.tables("dark"), key=lambda t: t["exposure_s"])
    if len(tables) < 3:
        raise Unsuitable
    d.swap(tables[0], tables[-1])


@mistake("one band's frames upside down", r"upside|turned|mirrored")
def _(d: Draft, rng: np.random.Generator) -> None:
    _frames_of(d, _some(d, "band", rng), lambda y: y[::-1])


# --- numbers -------------------------------------------------------------------------------------------------------


def _times(kind: str, key: str, factor: float) -> Callable[[Draft, np.random.Generator], None]:
    def make(d: Draft, rng: np.random.Generator) -> None:
        table = _some(d, kind, rng)
        if key not in table:
            raise Unsuitable
        table[key] = round(table[key] * factor, 6)

    return make


def _all_times(kind: str, key: str, factor: float) -> Callable[[Draft, np.random.Generator], None]:
    def make(d: Draft, rng: np.random.Generator) -> None:
        for table in d.tables(kind):
            table[key] = table[key] * factor

    return make


for _name, _make, _pattern in (
    (
        "exposure of one band twice too long",
        _times("band", "exposure_s", 2.0),
        r"exposure|does not suit|brighter|darker",
    ),
    (
        "exposure of one reference a third too long",
        _times("reference", "exposure_s", 4 / 3),
        r"reference|exposure",
    ),
    (
        "f-number of one band a stop off",
        _times("band", "f_number", 2**0.5),
        r"f.number|apertur|does not suit|exposure|darker|brighter",
    ),
    (
        "references' exposures in milliseconds",
        _all_times("reference", "exposure_s", 1e3),
        r"ms|millisec|exposure|reference",
    ),
    (
        "references' exposures twice too long",
        _all_times("reference", "exposure_s", 2.0),
        r"reference|exposure|constant|C\b",
    ),
):
    MISTAKES.append(Mistake(_name, _make, _pattern))


@mistake("gain of another setting, twice as large", r"gain")
def _(d: Draft, rng: np.random.Generator) -> None:
    d.manifest["camera"]["gain_e_per_dn"] *= 2


# --- spectra -------------------------------------------------------------------------------------------------------


def _shifted(table: NDArray, nm: float) -> NDArray:
    moved = [np.interp(table[:, 0] - nm, table[:, 0], column) for column in table[:, 1:].T]
    return np.column_stack([table[:, 0], *moved])


def _spectral(reference: Callable[[Draft], str | None], change: Callable[[NDArray, int], NDArray]) -> Callable:
    """The column of a reference through change(table, column)."""

    def make(d: Draft, rng: np.random.Generator) -> None:
        name = reference(d)
        _, column = d.columns(name)

        def changed(table: NDArray) -> NDArray:
            table[:, column] = change(table, column)
            return table

        d.rows(name, changed)

    return make


def _one_filter(d: Draft) -> str | None:
    return filters_of(d)[len(filters_of(d)) // 2]


for _name, _make, _pattern in (
    (
        "filter tables shifted by 10 nm",
        lambda d, rng: d.rows(_one_filter(d), lambda t: _shifted(t, 10.0)),
        r"filter|name",
    ),
    (
        "one filter's table reversed in wavelength",
        _spectral(_one_filter, lambda t, c: t[::-1, c]),
        r"filter|name",
    ),
    (
        "one filter's table as optical density",
        _spectral(_one_filter, lambda t, c: -np.log10(np.maximum(t[:, c], 1e-4))),
        r"filter",
    ),
    (
        "one filter's table normalised to a peak of 1",
        _spectral(_one_filter, lambda t, c: t[:, c] / t[:, c].max()),
        r"filter|does not suit|exposure",
    ),
    ("lens table as absorptance", _spectral(lens_of, lambda t, c: 1 - t[:, c]), r"lens|constant|factor|C\b"),
    (
        "quantum efficiency in A/W",
        _spectral(efficiency_of, lambda t, c: t[:, c] * t[:, 0] / 1239.8),
        r"efficiency|constant|band|factor",
    ),
    ("lamp in quanta, not energy", _spectral(lamp_of, lambda t, c: t[:, c] * t[:, 0] / 550), r"lamp"),
    ("lamp normalised to a peak of 1", _spectral(lamp_of, lambda t, c: t[:, c] / t[:, c].max()), r"lamp"),
    (
        "sphere normalised to a peak of 1",
        _spectral(sphere_of, lambda t, c: t[:, c] / t[:, c].max()),
        r"sphere|reference|radiance|factor",
    ),
    (
        "sphere in quanta, not energy",
        _spectral(sphere_of, lambda t, c: t[:, c] * t[:, 0] / 550),
        r"sphere|reference|constant|factor",
    ),
    ("lamp table reversed in wavelength", _spectral(lamp_of, lambda t, c: t[::-1, c]), r"lamp"),
):
    MISTAKES.append(Mistake(_name, _make, _pattern))  # type: ignore[arg-type]


@mistake("the lamp's table for the sphere", r"sphere|reference|same")
def _(d: Draft, rng: np.random.Generator) -> None:
    if lamp_of(d) is None:
        raise Unsuitable
    for table in d.tables("reference"):
        table["radiance"] = lamp_of(d)


# --- points --------------------------------------------------------------------------------------------------------


def _points(change: Callable[[NDArray], NDArray]) -> Callable[[Draft, np.random.Generator], None]:
    return lambda d, rng: d.points(lambda t: change(t.copy()))


for _name, _change, _pattern in (
    ("points in m", lambda t: np.column_stack([t[:, :3] / 1e3, t[:, 3:]]), r"in m\b"),
    ("points in inches", lambda t: np.column_stack([t[:, :3] / 25.4, t[:, 3:]]), r"inch|points"),
    (
        "points with x to the right",
        lambda t: np.column_stack([550 - t[:, 0], t[:, 1:]]),
        r"mirror|x runs|axes|points",
    ),
    (
        "points with z towards the viewer",
        lambda t: np.column_stack([t[:, :2], -t[:, 2], t[:, 3:]]),
        r"z runs|axes|points",
    ),
    (
        "points from the middle of the floor",
        lambda t: np.column_stack([t[:, 0] - 275, t[:, 1], t[:, 2] - 280, t[:, 3:]]),
        r"points|origin",
    ),
    (
        "two points' names exchanged",
        lambda t: np.vstack([np.column_stack([t[:2, :3], t[1::-1, 3:]]), t[2:]]),
        r"points",
    ),
):
    MISTAKES.append(Mistake(_name, _points(_change), _pattern))  # type: ignore[arg-type]


@mistake("the table of one colour channel off by 10 nm", r"displaced by [-+]1?\d nm|does not suit the references")
def _(d: Draft, rng: np.random.Generator) -> None:
    efficiency = d.manifest["camera"]["quantum_efficiency"]
    if not isinstance(efficiency, dict):
        raise Unsuitable
    column = efficiency[sorted(efficiency)[int(rng.integers(len(efficiency)))]]
    grid = np.loadtxt(d.columns(column)[0], delimiter=",", skiprows=1)[:, 0]
    shift = rng.choice([-10.0, 10.0])
    d.spectrum(column, lambda values: np.interp(grid - shift, grid, values))
