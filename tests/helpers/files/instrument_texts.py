"""Small files as instruments write them, after the published descriptions of the formats, and what they say."""

from dataclasses import dataclass

__all__ = ["INSTRUMENTS", "Instrument"]


@dataclass(frozen=True)
class Instrument:
    """A file of an instrument and its first spectrum."""

    #: Identifier of its reader.
    reader: str
    #: The file.
    text: str
    #: Name of its first spectrum.
    name: str
    #: Wavelengths of the first spectrum, nm.
    wavelength_nm: tuple[float, ...]
    #: Its values.
    values: tuple[float, ...]
    #: Its quantity.
    quantity: str = ""
    #: Its unit.
    unit: str = ""


UPRTEK = """Model Name\tMK350S
Serial Number\t17J00042
Time\t2024/05/02_10:11:12
Memo
LUX\t512.5
CCT\t2856.0
380nm\t0.25
381nm\t0.5
382nm\t0.75
"""

SEKONIC = """Date Saved,02/05/2024 10:11:12
Title,BENCH_001

Measuring Mode,Ambient
Tcp [K],2856
Spectral Data 380[nm],0.001
Spectral Data 385[nm],0.002
Spectral Data 380[nm],0.001
Spectral Data 381[nm],0.0012
Spectral Data 382[nm],0.0014

"""

XRITE = """LGOROWLENGTH\t2
CREATED\t"5/2/2024"  # Time: 10:11
INSTRUMENTATION\t"i1Pro"
NUMBER_OF_FIELDS\t5
BEGIN_DATA_FORMAT
SampleID\tSAMPLE_NAME\tnm400\tnm410\tnm420
END_DATA_FORMAT
NUMBER_OF_SETS\t2
BEGIN_DATA
1\tred\t0.1\t0.2\t0.3
2\tgreen\t0.4\t0.5\t0.6
END_DATA
"""

TI3 = """CTI3

DESCRIPTOR "Argyll Calibration Target chart information 3"
KEYWORD "DEVICE_CLASS"
DEVICE_CLASS "OUTPUT"
KEYWORD "SPECTRAL_BANDS"
SPECTRAL_BANDS "3"
SPECTRAL_START_NM "400.000000"
SPECTRAL_END_NM "420.000000"

NUMBER_OF_FIELDS 4
BEGIN_DATA_FORMAT
SAMPLE_ID SPEC_400 SPEC_410 SPEC_420
END_DATA_FORMAT

NUMBER_OF_SETS 1
BEGIN_DATA
A1 10.5 20.5 80.25
END_DATA
"""

SP = """SPECT

DESCRIPTOR "Argyll Spectral power/reflectance information"
ORIGINATOR "Argyll CMS"
MEAS_TYPE "EMISSION"
SPECTRAL_BANDS "3"
SPECTRAL_START_NM "380.000000"
SPECTRAL_END_NM "390.000000"
SPECTRAL_NORM "1.000000"

NUMBER_OF_FIELDS 3
BEGIN_DATA_FORMAT
SPEC_380 SPEC_385 SPEC_390
END_DATA_FORMAT

NUMBER_OF_SETS 1
BEGIN_DATA
0.5 1.25 2.5
END_DATA
"""

CXF = """<?xml version="1.0" encoding="UTF-8"?>
<cc:CxF xmlns:cc="http://colorexchangeformat.com/CxF3-core">
  <cc:FileInformation><cc:Creator>bench</cc:Creator></cc:FileInformation>
  <cc:Resources>
    <cc:ObjectCollection>
      <cc:Object ObjectType="Standard" Name="white wall" Id="c1">
        <cc:ColorValues>
          <cc:ReflectanceSpectrum ColorSpecification="cs1" StartWL="400">0.80 0.85
            0.875</cc:ReflectanceSpectrum>
        </cc:ColorValues>
      </cc:Object>
      <cc:Object ObjectType="Standard" Name="red wall" Id="c2">
        <cc:ColorValues>
          <cc:ReflectanceSpectrum ColorSpecification="cs1" StartWL="400">0.05 0.06 0.07</cc:ReflectanceSpectrum>
        </cc:ColorValues>
      </cc:Object>
    </cc:ObjectCollection>
    <cc:ColorSpecificationCollection>
      <cc:ColorSpecification Id="cs1">
        <cc:MeasurementSpec>
          <cc:MeasurementType>Spectrum_Reflectance</cc:MeasurementType>
          <cc:WavelengthRange StartWL="400" Increment="10"/>
        </cc:MeasurementSpec>
      </cc:ColorSpecification>
    </cc:ColorSpecificationCollection>
  </cc:Resources>
</cc:CxF>
"""

TM27 = """<?xml version="1.0" encoding="UTF-8"?>
<IESTM2714 xmlns="iestm2714" version="1.0">
  <Header>
    <Manufacturer>bench</Manufacturer>
    <Description>tungsten lamp</Description>
  </Header>
  <SpectralDistribution>
    <SpectralQuantity>radiance</SpectralQuantity>
    <BandwidthFWHM>5.0</BandwidthFWHM>
    <SpectralData wavelength="400.0">0.011</SpectralData>
    <SpectralData wavelength="405.5">0.012</SpectralData>
    <SpectralData wavelength="411.0">1.3e-2</SpectralData>
  </SpectralDistribution>
</IESTM2714>
"""

PR650 = """0000,1
 608.,1.234e-01
0380.,1.000e-05
0384.,2.000e-05
0388.,3.000e-05
"""

PR655 = """PR-655 S/N 65091802
00000,1,0608,1.234e-01,1.2e+16
380,1.000e-05
384,2.000e-05
388,4.000e-05
"""

CS2000 = """CS-S10w Professional,KONICA MINOLTA CS-2000
Unit,W/(sr m2 nm)
Data Name,Lv,x,y,380,381,382,383,384,385,386,387
lamp centre,120.5,0.45,0.41,0.001,0.002,0.003,0.004,0.005,0.006,0.007,0.008
lamp edge,110.5,0.45,0.41,0.0009,0.002,0.003,0.004,0.005,0.006,0.007,0.008
"""

OCEAN_OPTICS = """Data from bench_0001.txt Node

Date: Thu May 02 10:11:12 CEST 2024
Spectrometer: USB2+F01234
Integration Time (sec): 1.000000E-1
XAxis mode: Wavelengths
Number of Pixels in Spectrum: 3
>>>>>Begin Spectral Data<<<<<
339.09\t0.25
339.46\t-1.5
339.83\t12.75
"""

CARY = """paint A,,paint B,
Wavelength (nm),%R,Wavelength (nm),%R,
420.00,50.5,420.00,12.5,
410.00,40.25,410.00,11.5,
400.00,30.0,400.00,10.5,

paint A
Scan Software Version: 3.00
Scan Rate (nm/min) 600.000
"""

EUROPEAN = """# Spektralphotometer, sample 4
# operator: bench
Wellenlänge;white tile;grey tile
nm;% Reflectance;% Reflectance
420,0;95,50;20,25
410,0;95,00;20,00
400,0;94,25;19,75
"""

SPREADSHEET = """Wavelength (um)\tlamp [mW/m2/nm]
0.40\t1.5
0.41\t2.5
0.42\t3.5
"""

PERKIN_ELMER = """PE UV       SUBTECH     SPECTRUM    ASCII       PEDS        4.00
1
tile.sp
24/05/02
#HDR
1
#GR
nm
%R
1.0
0.0
420.0
-10.0
3
#DATA
420.000000\t30.5
410.000000\t20.5
400.000000\t10.5
"""

JCAMP = """##TITLE=red paint
##JCAMP-DX=4.24 $$ exported by the bench
##DATA TYPE=UV/VIS SPECTRUM
##XUNITS=NANOMETERS
##YUNITS=REFLECTANCE
##XFACTOR=1.0
##YFACTOR=0.001
##FIRSTX=420.0
##LASTX=400.0
##NPOINTS=3
##XYDATA=(X++(Y..Y))
420 305 205
400 105
##END=
"""

JCAMP_POINTS = """##TITLE=glass
##JCAMP-DX=5.00
##XUNITS=MICROMETERS
##YUNITS=% TRANSMITTANCE
##NPOINTS=3
##XYPOINTS=(XY..XY)
0.400,90.5; 0.410,91.5
0.420,92.5
##END=
"""

AVANTES = """bench.raw8

Integration time: 100.00 ms
Average: 10 scans
Wave   ;Sample   ;Dark
[nm]   ;[counts] ;[counts]

400,00;1000,5;10,0
410,00;1100,5;11,0
420,00;1200,5;12,0
"""

THORLABS = """[SpectraFile]
[InstrModel] CCS200
[xDataUnit] nm
[yDataUnit] INTENSITY
[Data]
400.00;0.105
410.00;0.205
420.00;0.305
"""

THORLABS_FILTER = """Wavelength (nm),% Transmission,Optical Density
400,0.5,2.30
410,20.5,0.69
420,85.5,0.07
"""

QTX = """[BATCH_DATA 0]
BAT_NAME=lot 17
BAT_REFLPOINTS=3,
BAT_REFLINTERVAL=10,
BAT_REFLLOW=400,
BAT_R=10.5,20.5,30.5,
"""

INSTRUMENTS = {
    "uprtek": Instrument(
        "uprtek", UPRTEK, "irradiance", (380, 381, 382), (0.25, 0.5, 0.75), "irradiance", "mW m^-2 nm^-1"
    ),
    "sekonic": Instrument(
        "sekonic", SEKONIC, "irradiance", (380, 381, 382), (0.001, 0.0012, 0.0014), "irradiance", "W m^-2 nm^-1"
    ),
    "xrite": Instrument("cgats", XRITE, "red", (400, 410, 420), (0.1, 0.2, 0.3)),
    "ti3": Instrument("cgats", TI3, "A1", (400, 410, 420), (0.105, 0.205, 0.8025), "reflectance", "per cent"),
    "sp": Instrument("cgats", SP, "value", (380, 385, 390), (0.5, 1.25, 2.5), "emission"),
    "cxf": Instrument("cxf", CXF, "white wall", (400, 410, 420), (0.80, 0.85, 0.875), "reflectance", "1"),
    "tm27": Instrument(
        "tm27", TM27, "radiance", (400, 405.5, 411), (0.011, 0.012, 0.013), "radiance", "W m^-2 sr^-1 nm^-1"
    ),
    "pr650": Instrument(
        "spectrascan", PR650, "radiance", (380, 384, 388), (1e-5, 2e-5, 3e-5), "radiance", "W m^-2 sr^-1 nm^-1"
    ),
    "pr655": Instrument(
        "spectrascan", PR655, "radiance", (380, 384, 388), (1e-5, 2e-5, 4e-5), "radiance", "W m^-2 sr^-1 nm^-1"
    ),
    "cs2000": Instrument(
        "sample_rows",
        CS2000,
        "lamp centre",
        tuple(range(380, 388)),
        (0.001, 0.002, 0.003, 0.004, 0.005, 0.006, 0.007, 0.008),
        "radiance",
        "W/(sr m2 nm)",
    ),
    "ocean_optics": Instrument("ocean_optics", OCEAN_OPTICS, "value", (339.09, 339.46, 339.83), (0.25, -1.5, 12.75)),
    "cary": Instrument("table", CARY, "paint A", (400, 410, 420), (0.30, 0.4025, 0.505), "reflectance", "per cent"),
    "european": Instrument(
        "table", EUROPEAN, "white tile", (400, 410, 420), (0.9425, 0.95, 0.955), "reflectance", "per cent"
    ),
    "spreadsheet": Instrument(
        "table", SPREADSHEET, "lamp [mW/m2/nm]", (400, 410, 420), (1.5, 2.5, 3.5), "irradiance", "mW/m2/nm"
    ),
    "qtx": Instrument("qtx", QTX, "lot 17", (400, 410, 420), (0.105, 0.205, 0.305), "reflectance", "per cent"),
    "perkin_elmer": Instrument(
        "perkin_elmer", PERKIN_ELMER, "reflectance", (400, 410, 420), (0.105, 0.205, 0.305), "reflectance", "per cent"
    ),
    "jcamp": Instrument(
        "jcamp", JCAMP, "reflectance", (400, 410, 420), (0.105, 0.205, 0.305), "reflectance", "reflectance"
    ),
    "jcamp_points": Instrument(
        "jcamp",
        JCAMP_POINTS,
        "transmittance",
        (400, 410, 420),
        (0.905, 0.915, 0.925),
        "transmittance",
        "% transmittance",
    ),
    "avantes": Instrument("table", AVANTES, "Sample", (400, 410, 420), (1000.5, 1100.5, 1200.5), "", "counts"),
    "thorlabs": Instrument("table", THORLABS, "INTENSITY", (400, 410, 420), (0.105, 0.205, 0.305)),
    "thorlabs_filter": Instrument(
        "table", THORLABS_FILTER, "% Transmission", (400, 410, 420), (0.005, 0.205, 0.855), "transmittance", "per cent"
    ),
}
