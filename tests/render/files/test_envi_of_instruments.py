"""Twelve headers in the manner of instruments, archives and programs, written anew from their published descriptions.

Six bands, five samples and four lines in place of the real sizes; keys, spellings, order and oddities are theirs.
"""

from dataclasses import dataclass, field

import numpy as np
import pytest
from cboxlab.rendering.files import Declared, read_cube
from cboxlab.utils.errors import InputError
from helpers.envi_files import LIGHT, RADIANCE, write

WHOLE = np.random.default_rng(5).integers(100, 4000, (4, 5, 6))


@dataclass(frozen=True)
class Case:
    """A header, its data file, and what is right."""

    header: str
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
        """ENVI
description = {
  AVIRIS-NG Measured Radiances in uW nm-1 cm-2 sr-1}
samples = 5
lines = 4
bands = 6
header offset = 0
file type = ENVI
data type = 4
interleave = bil
byte order = 0
map info = { UTM , 1.000 , 1.000 , 724522.127 , 4074620.759 , 1.1 , 1.1 , 12 , North , WGS-84 , units=Meters }
wavelength = { 376.719576 , 381.729575 , 386.739574 , 391.749574 , 396.749573 , 401.759572 }
fwhm = { 5.57 , 5.58 , 5.58 , 5.58 , 5.59 , 5.59 }
wavelength units = Nanometers
data ignore value = -9999
crosstrack scatter file = {none}
correction factors = { 1.0 , 1.0 , 1.0 , 1.0 , 1.0 , 1.0 }
bbl = { 0 , 1 , 1 , 1 , 1 , 1 }
smoothing factors = { 1 , 1 , 1 , 1 , 1 , 1 }
""",
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
        """ENVI
description = {
Frameperiod = 21000
Integration time = 20000
Binning = 1
Number of frames = 4
Scalefactor = 1.000000
ID = VNIR_1800_SN00812}
samples = 5
lines = 4
bands = 6
header offset = 40
file type = ENVI Standard
data type = 12
interleave = bil
byte order = 0
default bands = {5,3,1}
wavelength = {407.18, 410.37, 413.55, 416.74, 419.93, 423.11}
""",
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
        """ENVI
description = {
\tFile [Imported from ITK]}
file type = ENVI

sensor type = SPECIM FX10
acquisition date = DATE(yyyy-mm-dd): 2024-05-03
Start Time = UTC TIME: 09:12:44
Stop Time = UTC TIME: 09:12:51

samples = 5
bands   = 6
lines   = 4

errors = {none}

interleave = bil
data type = 12
header offset = 0
byte order = 0
x start = 0
y start = 0
default bands = {3, 2, 1}

himg = {1, 1024}
vimg = {38, 486}
hroi = {1, 1024}
vroi = {1, 512}

fps = 50.00
tint = 8.000000
binning = {4, 1}
trigger mode = Internal
fodis = {1, 1024}
sensorid = 420042
acquisitionwindow left = 0
calibration pack = C:/Users/Public/Documents/Specim/420042.scp

Wavelength = {
397.66,
400.28,
402.90,
405.52,
408.13,
410.75
}
fwhm = {
5.1,
5.1,
5.1,
5.1,
5.1,
5.1
}
""",
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
        """ENVI
description = {Headwall Hyperspec III, radiance, mW/(cm^2*um*sr)*10^-2}
samples = 5
lines = 4
bands = 6
header offset = 0
file type = ENVI Standard
data type = 4
interleave = bil
sensor type = Unknown
byte order = 0
wavelength units = nanometers
data units = mW/cm^2/um/sr
gain = 1.0
tint = 12.0
timestamp = 2023/06/01 10:11:12
rotation = {{1.0, 0.0}, {0.0, 1.0}}
wavelength = { 398.573, 400.795, 403.016, 405.237, 407.458, 409.680 }
""",
        "bil",
        "<f4",
        "raw_0_rd",
        [398.573, 400.795, 403.016, 405.237, 407.458, 409.680],
        expected=1e-2 * LIGHT,
        name="raw_0_rd.hdr",
    ),
    # Resonon's Spectronon: header x.bil.hdr, no unit, no file type
    "resonon": Case(
        """ENVI
interleave = bil
data type = 12
lines = 4
samples = 5
bands = 6
bit depth = 12
shutter = 10.0
gain = 0
framerate = 60.0
byte order = 0
header offset = 0
wavelength = {386.83, 388.91, 390.99, 393.07, 395.15, 397.24}
rotation = ((0.0, 1.0), (1.0, 0.0))
label = Cube 1
timestamp = 2021-07-05 15:20:01
original cube file = C:\\Users\\lab\\Données\\x.bil
data units = uW/cm^2/sr/um
""",
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
        """ENVI
description = {PRS_L1_HRC_VNIR}
samples = 5
lines = 4
bands = 6
header offset = 0
file type = ENVI Standard
data type = 12
interleave = bsq
byte order = 0
wavelength units = Nanometers
wavelength = {0.000000, 977.365417, 967.055847, 956.709595, 946.441162, 936.219360}
fwhm = {0.0, 13.98, 13.91, 13.77, 13.60, 13.53}
bbl = {0, 1, 1, 1, 1, 1}
data gain values = {0.01, 0.01, 0.01, 0.01, 0.01, 0.01}
data offset values = {0, 0, 0, 0, 0, 0}
data units = W/(m^2*sr*um)
""",
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
        """ENVI
description = {
  ENMAP01-____L1B-DT0000001234-SPECTRAL_IMAGE_VNIR}
samples = 5
lines   = 4
bands   = 6
header offset = 0
file type = ENVI Standard
data type = 2
interleave = bsq
sensor type = EnMAP
byte order = 0
data ignore value = 0
wavelength units = Nanometers
wavelength = {418.24, 423.874, 429.294, 434.528, 439.603, 444.546}
fwhm = {7.02, 6.86, 6.71, 6.58, 6.46, 6.36}
data gain values = {1.0e-05, 2.0e-05, 3.0e-05, 4.0e-05, 5.0e-05, 6.0e-05}
data offset values = {0.001, 0.001, 0.001, 0.001, 0.001, 0.001}
data units = W/m^2/sr/nm
""",
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
        """ENVI
description = {CASI-1500 spectral radiance, SRU}
samples = 5
lines = 4
bands = 6
header offset = 0
file type = ENVI Standard
data type = 12
interleave = bip
sensor type = CASI
byte order = 1
wavelength units = Nanometres
wavelength = {
 367.5, 377.1, 386.7,
 396.3, 405.9, 415.5}
band names = {
 Band 1 (367.5 nm), Band 2 (377.1 nm), Band 3 (386.7 nm),
 Band 4 (396.3 nm), Band 5 (405.9 nm), Band 6 (415.5 nm)}
""",
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
        """ENVI
description = {TASI-600, Größe 600 px}
samples = 5
lines = 4
bands = 6
header offset = 0
file type = ENVI Standard
data type = 4
interleave = bil
byte order = 0
wavelength units = µm
wavelength = {8.0541, 8.1637, 8.2732, 8.3828, 8.4923, 8.6019}
data units = W m-2 sr-1 um-1
""",
        "bil",
        "<f4",
        "x.img",
        [8054.1, 8163.7, 8273.2, 8382.8, 8492.3, 8601.9],
        expected=1e-3 * LIGHT,
        encoding="cp1252",
    ),
    # Cubert: a comment in front, one list a line with a comma at its end, lines of Windows
    "cubert": Case(
        """ENVI
; exported by CubeUtils
samples = 5
lines = 4
bands = 6
header offset = 0
file type = ENVI Standard
data type = 12
interleave = bip
byte order = 0
wavelength units = Nanometer
wavelength = {450,454,458,462,466,470,}
; integration time 5 ms
data units = mW m^-2 sr^-1 nm^-1
""".replace("\n", "\r\n"),
        "bip",
        "<u2",
        "x.bin",
        [450, 454, 458, 462, 466, 470],
        WHOLE,
        expected=1e-3 * WHOLE,
    ),
    # ENVI Classic after ERDAS: reflectance keys that do not concern radiance, lists over lines, frame offsets of 0
    "envi-classic": Case(
        """ENVI
description = {
  File Imported into ENVI [Mon Jan 13 11:02:05 2003]}
samples = 5
lines   = 4
bands   = 6
header offset = 128
major frame offsets = {0, 0}
minor frame offsets = {0, 0}
file type = ENVI Standard
data type = 3
interleave = bsq
sensor type = Unknown
byte order = 0
x start = 1
y start = 1
default stretch = 2.0% linear
wavelength units = Micrometers
z plot range = {0.00, 100.00}
z plot titles = {Wavelength, Radiance}
data reflectance gain values = {1.0, 1.0, 1.0, 1.0, 1.0, 1.0}
data reflectance offset values = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0}
band names = {
 Layer_1, Layer_2, Layer_3, Layer_4,
 Layer_5, Layer_6}
wavelength = {
 0.450000, 0.500000, 0.550000, 0.600000,
 0.650000, 0.700000}
data units = W/m^2/sr/um
pixel size = {3.0e+00, 3.0e+00, units=Meters}
""",
        "bsq",
        "<i4",
        "x.img",
        [450, 500, 550, 600, 650, 700],
        WHOLE,
        expected=1e-3 * WHOLE,
    ),
    # Spectral Python's envi.save_image: keys in alphabetical order, spaces around commas
    "spectral-python": Case(
        """ENVI
band names = { b1 , b2 , b3 , b4 , b5 , b6 }
bands = 6
byte order = 0
data type = 4
description = { }
file type = ENVI Standard
header offset = 0
interleave = bip
lines = 4
reflectance scale factor = 100.0
samples = 5
wavelength = { 400.0 , 450.0 , 500.0 , 550.0 , 600.0 , 650.0 }
wavelength units = nm
data units = W m-2 sr-1 nm-1
""",
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
        case.header,
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
