"""Twelve headers in the manner of instruments, archives and programs, written again from their published descriptions.

Six bands, five samples and four lines in place of the real sizes; keys, spellings, order and oddities are theirs.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from cboxlab.rendering.files import Declared, read_cube
from cboxlab.utils.errors import InputError
from helpers.files.envi_files import LIGHT, RADIANCE, write

HEADERS = Path(__file__).parent / "envi_headers"
WHOLE = np.random.default_rng(5).integers(100, 4000, (4, 5, 6))


@dataclass(frozen=True)
class Case:
    """The data file of a header in ``envi_headers``, and what is right."""

    order: str
    kind: str
    data: str
    nm: list[float]
    values: np.ndarray = field(default_factory=lambda: LIGHT)
    expected: np.ndarray | None = None
    declared: Declared = Declared()  # noqa: RUF009
    name: str = "x.hdr"
    encoding: str = "utf-8"
    asks: str = ""
    notes: str = ""


CASES = {
    # Jet Propulsion Laboratory: radiance in uW nm^-1 cm^-2 sr^-1 says the description alone
    "aviris-ng": Case(
        "bil",
        "<f4",
        "x",
        [381.729575, 386.739574, 391.749574, 396.749573, 401.759572],
        expected=1e-2 * LIGHT[..., 1:],
        declared=Declared("uW cm^-2 sr^-1 nm^-1"),
        asks="declare units",
        notes="left out: 376.72 nm",
    ),
    # NEO: settings with equals signs inside the description, an embedded header in front of the samples, no unit
    "hyspex": Case(
        "bil",
        "<u2",
        "x.hyspex",
        [407.18, 410.37, 413.55, 416.74, 419.93, 423.11],
        WHOLE,
        expected=1e-5 * WHOLE,
        declared=Declared(RADIANCE, 1e-5, wavelength_unit="nm"),
        asks="declare units",
    ),
    # Specim: keys with capitals, one wavelength a line, dates with colons, x and y from 0, no unit
    "specim": Case(
        "bil",
        "<u2",
        "x.raw",
        [397.66, 400.28, 402.90, 405.52, 408.13, 410.75],
        WHOLE,
        expected=1e-5 * WHOLE,
        declared=Declared(RADIANCE, 1e-5, wavelength_unit="nm"),
        asks="declare units",
    ),
    # Headwall: data file without an ending, header named after it
    "headwall": Case(
        "bil",
        "<f4",
        "raw_0_rd",
        [398.573, 400.795, 403.016, 405.237, 407.458, 409.680],
        expected=1e-2 * LIGHT,
        name="raw_0_rd.hdr",
    ),
    # Resonon's Spectronon: header x.bil.hdr, no unit, no file type
    "resonon": Case(
        "bil",
        "<u2",
        "x.bil",
        [386.83, 388.91, 390.99, 393.07, 395.15, 397.24],
        WHOLE,
        expected=1e-5 * WHOLE,
        declared=Declared(wavelength_unit="nm"),
        name="x.bil.hdr",
        encoding="latin-1",
        asks="declare wavelength-unit",
    ),
    # Italian Space Agency, exported: the visible range descends, unused bands have the wavelength 0
    "prisma": Case(
        "bsq",
        "<u2",
        "x.dat",
        [936.21936, 946.441162, 956.709595, 967.055847, 977.365417],
        WHOLE,
        expected=1e-5 * WHOLE[..., :0:-1],
        notes="data gain values",
    ),
    # German Aerospace Center: capital ending, gains and offsets for each band, 0 is no data
    "enmap": Case(
        "bsq",
        "<i2",
        "x.BSQ",
        [418.24, 423.874, 429.294, 434.528, 439.603, 444.546],
        WHOLE,
        expected=1e-5 * WHOLE * np.arange(1, 7) + 0.001,
        name="x.HDR",
        notes="data gain values and data offset values",
    ),
    # CASI after ITRES' radiometric correction: 1000 units are 1 uW cm^-2 sr^-1 nm^-1, big endian, old tools' spelling
    "casi": Case(
        "bip",
        ">u2",
        "x.pix",
        [367.5, 377.1, 386.7, 396.3, 405.9, 415.5],
        WHOLE,
        expected=1e-5 * WHOLE,
        declared=Declared("uW cm^-2 sr^-1 nm^-1", 1e-3),
        asks="declare units",
    ),
    # ITRES' thermal imager: micrometres with the micro sign of Windows
    "itres-tasi": Case(
        "bil",
        "<f4",
        "x.img",
        [8054.1, 8163.7, 8273.2, 8382.8, 8492.3, 8601.9],
        expected=1e-3 * LIGHT,
        encoding="cp1252",
    ),
    # Cubert: a comment in front, one list a line with a comma at its end, lines of Windows
    "cubert": Case(
        "bip",
        "<u2",
        "x.bin",
        [450, 454, 458, 462, 466, 470],
        WHOLE,
        expected=1e-3 * WHOLE,
    ),
    # ENVI Classic after ERDAS: reflectance keys that do not concern radiance, lists over lines, frame offsets of 0
    "envi-classic": Case(
        "bsq",
        "<i4",
        "x.img",
        [450, 500, 550, 600, 650, 700],
        WHOLE,
        expected=1e-3 * WHOLE,
    ),
    # Spectral Python's envi.save_image: keys in alphabetical order, spaces around commas
    "spectral-python": Case(
        "bip",
        "<f4",
        "x.img",
        [400, 450, 500, 550, 600, 650],
        expected=LIGHT / 100,
        notes="reflectance scale factor",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_headers_of_real_instruments_and_programs(tmp_path, name):
    case = CASES[name]
    path = write(
        tmp_path / "cube",
        (HEADERS / f"{name}.hdr").read_bytes().decode(case.encoding),
        case.values,
        order=case.order,
        kind=case.kind,
        data=case.data,
        header=case.name,
        encoding=case.encoding,
    )
    offset = {"hyspex": 40, "envi-classic": 128}.get(name, 0)
    samples = path.with_name(case.data)
    samples.write_bytes(b"\1" * offset + samples.read_bytes())
    if case.asks:
        with pytest.raises(InputError, match=case.asks):
            read_cube(path)
    cube = read_cube(path, case.declared)
    np.testing.assert_allclose(cube["wavelength"], case.nm, rtol=1e-9)
    np.testing.assert_allclose(cube["radiance"], case.expected, rtol=1e-6)
    assert case.notes in cube.attrs.get("reading_notes", "")
