"""Boxes and instruments for blind captures: next to the published box and its camera, others that differ widely."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.rendering.synthetic import CaptureSettings, band_filters, behind_mosaic, tungsten_lamp
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM

Paint = Mapping[str, object]
Entry = dict[str, Any]

_NM = np.arange(380.0, 731.0, 5.0)

#: A room of the published size without its slight skew, mm; +x is to the viewer's left, the front is open.
_WIDE, _HIGH, _DEEP = 550.0, 549.0, 559.0


def _paint(values: object) -> Paint:
    curve = np.broadcast_to(np.asarray(values, float), _NM.shape)
    return {"wavelength_nm": _NM.tolist(), "values": np.round(curve, 5).tolist()}


def _step(at_nm: float, width_nm: float) -> np.ndarray:
    return 1 / (1 + np.exp(-(_NM - at_nm) / width_nm))


def _line(at_nm: float, width_nm: float) -> np.ndarray:
    return np.exp(-0.5 * ((_NM - at_nm) / width_nm) ** 2)


_PAINTS: dict[str, Paint] = {
    "chalk": _paint(0.78 + 0.08 * _step(430, 12)),
    "grey": _paint(0.4),
    "soot": _paint(0.05 + 0.01 * _step(600, 30)),
    "blue": _paint(0.08 + 0.5 * _line(460, 35) + 0.05 * _step(690, 8)),
    "yellow": _paint(0.06 + 0.68 * _step(515, 14)),
    "brick": _paint(0.1 + 0.4 * _step(590, 18)),
    # two absorption bands on a bright ground, as of rare earths
    "didymium": _paint(0.82 - 0.45 * _line(580, 9) - 0.25 * _line(525, 12)),
    "leaf": _paint(0.05 + 0.12 * _line(550, 25) + 0.45 * _step(705, 8)),
}


def _wall(name: str, material: str, corners: list[list[float]], **more: object) -> Entry:
    return {"name": name, "material": material, "quads_mm": [corners], **more}


def _room(left: str, right: str, rest: str, floor: str | None = None) -> list[Entry]:
    x, y, z = _WIDE, _HIGH, _DEEP
    return [
        _wall("floor", floor or rest, [[x, 0, 0], [0, 0, 0], [0, 0, z], [x, 0, z]]),
        _wall("back", rest, [[x, 0, z], [0, 0, z], [0, y, z], [x, y, z]]),
        _wall("right", right, [[0, 0, z], [0, 0, 0], [0, y, 0], [0, y, z]]),
        _wall("left", left, [[x, 0, 0], [x, 0, z], [x, y, z], [x, y, 0]]),
    ]


def _ceiling(material: str, lamps: list[tuple[float, float, float, float]]) -> tuple[Entry, list[Any]]:
    """The ceiling and its lamps (x, z of the middle and half the sizes), each lamp in a part of the ceiling."""
    edges = [_WIDE * (i + 1) / len(lamps) for i in range(len(lamps))]
    parts, quads = [], []
    for start, end, (x, z, half_x, half_z) in zip([0.0, *edges], edges, lamps, strict=False):
        parts.append([[end, _HIGH, 0], [end, _HIGH, _DEEP], [start, _HIGH, _DEEP], [start, _HIGH, 0]])
        near, far = z - half_z, z + half_z
        quads.append(
            [
                [x + half_x, _HIGH, near],
                [x + half_x, _HIGH, far],
                [x - half_x, _HIGH, far],
                [x - half_x, _HIGH, near],
            ]
        )
    return {"name": "ceiling", "material": material, "quads_mm": parts, "hole": "light"}, quads


def _block(name: str, material: str, middle: tuple[float, float], size: list[float], yaw_deg: float) -> Entry:
    centre = [middle[0], size[1] / 2, middle[1]]
    return {
        "name": name,
        "material": material,
        "box": {"center_mm": centre, "size_mm": size, "yaw_deg": yaw_deg},
    }


_TWO_BLOCKS = (
    ("tall-block", (180.0, 380.0), [160.0, 330.0, 160.0], 20.0),
    ("short-block", (380.0, 170.0), [170.0, 150.0, 150.0], -15.0),
)
_MIDDLE = [(278.0, 280.0, 65.0, 52.5)]


def _blocks(material: str) -> list[Entry]:
    return [_block(name, material, *how) for name, *how in _TWO_BLOCKS]  # type: ignore[arg-type]


def _pyramid(folder: Path) -> str:
    """A pyramid on the floor, as a mesh file; its name."""
    text = "v 90 0 90\nv 250 0 90\nv 250 0 250\nv 90 0 250\nv 170 190 170\n"
    faces = "f 2 1 5\nf 3 2 5\nf 4 3 5\nf 1 4 5\n"
    (folder / "pyramid.obj").write_text(text + faces)
    return "pyramid.obj"


def _ball_and_mesh(folder: Path) -> tuple[list[Entry], list[Any]]:
    ceiling, lamps = _ceiling("chalk", _MIDDLE)
    ball = {"center_mm": [380.0, 120.0, 330.0], "radius_mm": 120.0}
    entries: list[Entry] = [
        {"name": "ball", "material": "grey", "sphere": ball},
        {"name": "pyramid", "material": "chalk", "mesh": _pyramid(folder)},
    ]
    return [*_room("brick", "blue", "chalk"), ceiling, *entries], lamps


def _two(left: str, right: str, rest: str, blocks: str, lamps: list[tuple[float, float, float, float]]):  # type: ignore[no-untyped-def]
    def room_and_quads(folder: Path) -> tuple[list[Entry], list[Any]]:
        ceiling, quads = _ceiling(rest, lamps)
        return [*_room(left, right, rest), ceiling, *_blocks(blocks)], quads

    return room_and_quads


def _one_block(folder: Path) -> tuple[list[Entry], list[Any]]:
    ceiling, lamps = _ceiling("grey", _MIDDLE)
    block = _block("middle-block", "chalk", (300.0, 300.0), [200.0, 220.0, 120.0], 35.0)
    return [*_room("yellow", "blue", "grey", floor="chalk"), ceiling, block], lamps


_Made = Callable[[Path], tuple[list[Entry], list[Any]]]

#: Boxes by name, without the published one: what they hold, and their lamps.
_OWN: dict[str, _Made] = {
    "elsewhere": _two("blue", "yellow", "chalk", "grey", _MIDDLE),
    "one-block": _one_block,
    "ball-and-mesh": _ball_and_mesh,
    "structured": _two("leaf", "soot", "didymium", "brick", _MIDDLE),
    "large-lamp": _two("brick", "leaf", "chalk", "chalk", [(278.0, 280.0, 150.0, 150.0)]),
    "small-lamp": _two("brick", "leaf", "chalk", "chalk", [(278.0, 280.0, 15.0, 15.0)]),
    "two-lamps": _two("yellow", "blue", "grey", "chalk", [(140.0, 200.0, 40.0, 40.0), (410.0, 380.0, 40.0, 40.0)]),
}

BOXES = ("published", *_OWN)


@cache
def scene_of(box: str) -> str:
    """What a model names as its scene: the published box, or a scene file written for the run."""
    if box == "published":
        return "cornell-box"
    folder = Path(tempfile.mkdtemp(prefix="cbox-blind-"))
    surfaces, lamps = _OWN[box](folder)
    used = {entry["material"] for entry in surfaces}
    area = sum(np.linalg.norm(np.cross(np.subtract(q[1], q[0]), np.subtract(q[3], q[0]))) for q in map(np.array, lamps))
    # as much light as the published lamp, of 130 x 105 mm, gives
    radiance = tungsten_lamp(8e-4 * 130 * 105 / area)
    lamp = {
        "quads_mm": lamps,
        "radiance": {"wavelength_nm": WAVELENGTH_NM.tolist(), "values": radiance.values.tolist()},
        "reflectance": 0.6,
    }
    lines = ['format = "scene/1"', f'name = "{box}"', "[lamp]", *_entries(lamp)]
    for name in sorted(used):
        lines += [f"[material.{name}]", *_entries({"reflectance": _PAINTS[name]})]
    for entry in surfaces:
        lines += ["[[surface]]", *_entries(entry)]
    path = folder / f"{box}.toml"
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def _entries(table: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {_value(value)}" for key, value in table.items()]


def _value(value: object) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(_entries(value)) + "}"
    return json.dumps(value)


def _filters(centres_nm: list[float], width_nm: float, peak: float) -> dict[str, Spectrum]:
    """Nearly rectangular pass bands of ``width_nm`` at half height."""
    grid = next(iter(band_filters().values())).wavelength_nm
    return {
        f"f{centre:g}": Spectrum(grid, peak * np.exp(-np.log(2) * (2 * (grid - centre) / width_nm) ** 4), "zero")
        for centre in centres_nm
    }


#: Instruments by name: pixels a side, and what they change in the settings of a laboratory.
INSTRUMENTS: dict[str, tuple[int, Callable[[CaptureSettings], CaptureSettings]]] = {
    "plain": (128, lambda s: s),
    "coarse": (
        128,
        lambda s: replace(
            s,
            bit_depth=10,
            gain_e_per_dn=40.0,
            read_noise_e=30.0,
            repeats=3,
            bias_dn=30.0,
            filters=_filters([450.0, 530.0, 600.0, 660.0], 40.0, 0.6),
        ),
    ),
    "fine": (
        128,
        lambda s: replace(
            s,
            bit_depth=16,
            gain_e_per_dn=1.6,
            read_noise_e=3.0,
            bias_dn=600.0,
            filters=_filters([400.0 + 20 * i for i in range(16)], 18.0, 0.5),
        ),
    ),
    "large": (
        256,
        lambda s: replace(
            s,
            bit_depth=14,
            gain_e_per_dn=4.0,
            read_noise_e=7.0,
            bias_dn=250.0,
            filters=_filters([410.0 + 30 * i for i in range(10)], 22.0, 0.55),
        ),
    ),
    "bayer": (64, lambda s: behind_mosaic(s, "RGGB")),
    "bayer-grbg": (64, lambda s: behind_mosaic(replace(s, bit_depth=14, gain_e_per_dn=3.0, bias_dn=400.0), "GRBG")),
    "rgbw": (64, lambda s: behind_mosaic(s, "WRGB")),
    "filter-array": (64, lambda s: behind_mosaic(s, "ABCD EFGH IJKL MNOP")),
    "x-trans": (64, lambda s: behind_mosaic(s, "GGRGGB GGBGGR BRGRBG GGBGGR GGRGGB RBGBRG")),
    "rccb": (64, lambda s: behind_mosaic(s, "RCCB")),
    "filter-array-25": (65, lambda s: behind_mosaic(s, "ABCDE FGHIJ KLMNO PQRST UVWXY")),
    "bayer-filters": (
        64,
        lambda s: replace(behind_mosaic(s, "GBRG"), filters=_filters([470.0, 600.0], 40.0, 0.6)),
    ),
}
