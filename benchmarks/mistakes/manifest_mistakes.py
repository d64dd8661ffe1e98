"""Mistakes in numbers and spectra of a capture."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from capture_mistakes import MISTAKES, Draft, Mistake, Unsuitable, mistake
from numpy.typing import NDArray


def _times(key: str, factor: float, *kinds: str) -> Callable[[Draft, np.random.Generator], None]:
    def make(draft: Draft, rng: np.random.Generator) -> None:
        for table in draft.tables(*kinds):
            if key in table:
                table[key] = table[key] * factor

    return make


def _set(table: str, key: str, change: Callable[[Any], Any]) -> Callable[[Draft, np.random.Generator], None]:
    def make(draft: Draft, rng: np.random.Generator) -> None:
        if key not in draft.manifest.get(table, {}):
            raise Unsuitable
        draft.manifest[table][key] = change(draft.manifest[table][key])

    return make


def _every(*kinds: str) -> Callable[[Draft], Iterator[dict]]:
    def tables(draft: Draft) -> Iterator[dict]:
        for kind in kinds:
            if isinstance(draft.manifest.get(kind), list):
                yield from draft.manifest[kind]

    return tables


# --- numbers of the manifest ---------------------------------------------------------------------------------------


@mistake("all exposures in milliseconds", r"ms|millisec|another unit|exposure")
def _(d: Draft, rng: np.random.Generator) -> None:
    for table in _every("band", "bracket", "flat", "reference", "dark")(d):
        table["exposure_s"] *= 1000.0


@mistake("exposure of one band ten times too long", r"exposure")
def _(d: Draft, rng: np.random.Generator) -> None:
    table = rng.choice(d.tables("band"))  # type: ignore[arg-type]
    table["exposure_s"] *= 10.0


@mistake("exposure of one band ten times too short", r"exposure")
def _(d: Draft, rng: np.random.Generator) -> None:
    table = rng.choice(d.tables("band"))  # type: ignore[arg-type]
    table["exposure_s"] /= 10.0


@mistake("exposure of one reference ten times too short", r"exposure")
def _(d: Draft, rng: np.random.Generator) -> None:
    table = rng.choice(d.tables("reference"))  # type: ignore[arg-type]
    table["exposure_s"] /= 10.0


@mistake("aperture diameter in place of the f-number", r"apertur|f-number|f_number")
def _(d: Draft, rng: np.random.Generator) -> None:
    focal = d.manifest["lens"]["focal_length_mm"]
    for table in _every("band", "bracket", "flat", "reference")(d):
        if "f_number" in table:
            table["f_number"] = round(focal / table["f_number"], 3)


@mistake("f-number two stops off", r"apertur|f-number|f_number")
def _(d: Draft, rng: np.random.Generator) -> None:
    for table in _every("band", "bracket", "flat", "reference")(d):
        if "f_number" in table:
            table["f_number"] *= 2.0


for _name, _key, _table, _change, _pattern in (
    ("focal length in cm", "focal_length_mm", "lens", lambda x: x / 10, r"focal"),
    ("focal length in m", "focal_length_mm", "lens", lambda x: x / 1000, r"focal"),
    ("focal length of another lens (50 mm)", "focal_length_mm", "lens", lambda x: 50.0, r"focal"),
    ("pixel pitch in mm", "pixel_pitch_um", "camera", lambda x: x / 1000, r"pixel pitch"),
    ("pixel pitch of a sensor binned by two", "pixel_pitch_um", "camera", lambda x: x / 2, r"pixel pitch"),
    ("gain inverted", "gain_e_per_dn", "camera", lambda x: 1 / x, r"gain"),
    ("read noise in DN", "read_noise_e", "camera", lambda x: x / 12, r"read noise"),
    ("bit depth of the container", "bit_depth", "camera", lambda x: 16, r"full scale|bit depth"),
    ("bit depth too small", "bit_depth", "camera", lambda x: x - 2, r"bit_depth|full scale"),
    ("lamp uncertainty in per cent", "relative_uncertainty", "lamp", lambda x: 100 * x, r"per cent"),
    ("point sigma ten times too small", "point_sigma_px", "geometry", lambda x: x / 10, r"scatter"),
):
    MISTAKES.append(Mistake(_name, _set(_table, _key, _change), _pattern))  # type: ignore[arg-type, no-untyped-call]

for _name, _factor in (("image distance in m", 1e-3), ("image distance in cm", 0.1)):
    MISTAKES.append(
        Mistake(_name, _times("image_distance_mm", _factor, "band", "flat", "reference"), r"image distance")
    )


@mistake("start times out of order", r"start|order|begin")
def _(d: Draft, rng: np.random.Generator) -> None:
    a, b = d.two("band", rng)
    if "start_s" not in a or "start_s" not in b:
        raise Unsuitable
    a["start_s"], b["start_s"] = b["start_s"], a["start_s"]


@mistake("start times in minutes", r"start|begin")
def _(d: Draft, rng: np.random.Generator) -> None:
    _times("start_s", 1 / 60, "band")(d, rng)
    if "start_s" not in d.tables("band")[0]:
        raise Unsuitable


# --- spectra -------------------------------------------------------------------------------------------------------


def _spectrum(get: Callable[[Draft], list[str | None]], change: Callable) -> Callable:
    def make(d: Draft, rng: np.random.Generator) -> None:
        for reference in dict.fromkeys(get(d)):
            d.spectrum(reference, change)

    return make


def _rows(get: Callable[[Draft], str | None], change: Callable) -> Callable:
    return lambda d, rng: d.rows(get(d), change)


def efficiency_of(d: Draft) -> str | None:
    efficiency = d.manifest["camera"].get("quantum_efficiency")
    return efficiency[0] if isinstance(efficiency, list) else efficiency


def lens_of(d: Draft) -> str | None:
    return d.manifest.get("lens", {}).get("transmittance")


def lamp_of(d: Draft) -> str | None:
    return d.manifest.get("lamp", {}).get("radiance")


def sphere_of(d: Draft) -> str | None:
    return d.tables("reference")[0]["radiance"]


def filters_of(d: Draft) -> list[str | None]:
    return [table.get("transmittance") for table in d.tables("band")]


def _nm(factor: float) -> Callable[[NDArray], NDArray]:
    return lambda table: np.column_stack([factor * table[:, 0], table[:, 1:]])


for _name, _make, _pattern in (
    ("filter transmittances in per cent", _spectrum(filters_of, lambda y: 100 * y), r"per cent"),
    (
        "one filter's transmittance in per cent",
        _spectrum(lambda d: filters_of(d)[2:3], lambda y: 100 * y),
        r"per cent",
    ),
    (
        "quantum efficiency in per cent",
        _spectrum(lambda d: [efficiency_of(d)], lambda y: 100 * y),
        r"per cent",
    ),
    ("lens transmittance in per cent", _spectrum(lambda d: [lens_of(d)], lambda y: 100 * y), r"per cent"),
    (
        "lens transmittance above 1",
        _spectrum(lambda d: [lens_of(d)], lambda y: 1.15 * y / y.max()),
        r"above 1|within 0",
    ),
    (
        "sphere a thousand times too bright",
        _spectrum(lambda d: [sphere_of(d)], lambda y: 1e3 * y),
        r"thousand|reference",
    ),
    (
        "sphere in photometric units",
        _spectrum(lambda d: [sphere_of(d)], lambda y: 683 * y),
        r"photometric|reference",
    ),
    (
        "sphere's irradiance for its radiance",
        _spectrum(lambda d: [sphere_of(d)], lambda y: np.pi * y),
        r"pi|reference",
    ),
    (
        "sphere's flux for its radiance",
        _spectrum(lambda d: [sphere_of(d)], lambda y: 4 * np.pi * y),
        r"4 pi|reference",
    ),
    ("lamp per micrometre", _spectrum(lambda d: [lamp_of(d)], lambda y: 1e3 * y), r"lamp"),
    ("lamp's irradiance per cm^2", _spectrum(lambda d: [lamp_of(d)], lambda y: 1e-4 * y), r"lamp"),
    ("lamp table in micrometres", _rows(lamp_of, _nm(1e-3)), r"micromet"),
    ("lamp table in angstroms", _rows(lamp_of, _nm(10.0)), r"angstrom"),
    ("filter table in micrometres", _rows(lambda d: filters_of(d)[0], _nm(1e-3)), r"micromet"),
    ("camera table in angstroms", _rows(efficiency_of, _nm(10.0)), r"angstrom"),
    ("lamp table cut at 600 nm", _rows(lamp_of, lambda t: t[t[:, 0] <= 600]), r"cut|cover"),
    ("camera table from 450 nm on", _rows(efficiency_of, lambda t: t[t[:, 0] >= 450]), r"cut|cover"),
    (
        "filter table cut at 600 nm",
        _rows(lambda d: filters_of(d)[0], lambda t: t[t[:, 0] <= 600]),
        r"cut|cover",
    ),
    ("wavelengths descending", _rows(lamp_of, lambda t: t[::-1]), r"ascending"),
):
    MISTAKES.append(Mistake(_name, _make, _pattern))


@mistake("two bands' filter tables exchanged", r"filter")
def _(d: Draft, rng: np.random.Generator) -> None:
    a, b = d.two("band", rng)
    a["transmittance"], b["transmittance"] = b["transmittance"], a["transmittance"]


@mistake("one filter's table for two bands", r"same|filter")
def _(d: Draft, rng: np.random.Generator) -> None:
    a, b = d.two("band", rng)
    (path, first), (other_path, two) = d.columns(a["transmittance"]), d.columns(b["transmittance"])
    if path != other_path:
        raise Unsuitable

    def copied(table: NDArray) -> NDArray:
        table[:, two] = table[:, first]
        return table

    d.rows(a["transmittance"], copied)


@mistake("the sphere's table for the lamp", r"lamp")
def _(d: Draft, rng: np.random.Generator) -> None:
    if "lamp" not in d.manifest:
        raise Unsuitable
    d.manifest["lamp"]["radiance"] = sphere_of(d)
