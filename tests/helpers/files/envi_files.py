"""ENVI files with headers of any text."""

from pathlib import Path

import numpy as np

RADIANCE = "W m^-2 sr^-1 nm^-1"
#: y, x, wavelength
LIGHT = np.random.default_rng(11).random((4, 5, 6)).astype(np.float32) + 0.5
NM = np.array([400.0, 450.0, 500.0, 550.0, 600.0, 650.0])
ENTRIES = {
    "samples": "5",
    "lines": "4",
    "bands": "6",
    "header offset": "0",
    "file type": "ENVI Standard",
    "data type": "4",
    "interleave": "bsq",
    "byte order": "0",
    "data units": RADIANCE,
    "wavelength units": "Nanometers",
    "wavelength": "{400, 450, 500, 550, 600, 650}",
}
TURNED = {"bsq": (2, 0, 1), "bil": (0, 2, 1), "bip": (0, 1, 2)}


def header_text(without=(), after="", **changed) -> str:
    """The text of a header; names of changed entries have _ in place of spaces."""
    entries = ENTRIES | {name.replace("_", " "): str(value) for name, value in changed.items()}
    lines = [f"{key} = {value}" for key, value in entries.items() if key not in without]
    return "\n".join(["ENVI", "description = {a test}", *lines]) + "\n" + after


def write(
    folder: Path, text: str, values=LIGHT, *, order="bsq", kind="<f4", data="x.img", header="x.hdr", encoding="utf-8"
) -> Path:
    """Header and samples; returns the header's path."""
    folder.mkdir(exist_ok=True)
    (folder / header).write_bytes(text.encode(encoding))
    (folder / data).write_bytes(np.ascontiguousarray(values.transpose(TURNED[order]), kind).tobytes())
    return folder / header
