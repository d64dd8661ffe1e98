"""IES TM-27-14 files (.spdx, .xml): spectra of lamps and materials in XML."""

from __future__ import annotations

from cboxlab.utils.errors import InputError

from ._spectrum_reader import InstrumentFile, InstrumentText, SpectrumReader, decimal_number, measured_spectrum
from ._xml import parse_xml

#: By quantity of the standard, its unit there.
_UNITS = {
    "flux": "W nm^-1",
    "intensity": "W sr^-1 nm^-1",
    "irradiance": "W m^-2 nm^-1",
    "radiance": "W m^-2 sr^-1 nm^-1",
    "exitance": "W m^-2 nm^-1",
    "reflectance": "1",
    "transmittance": "1",
    "absorptance": "1",
    "r-value": "1",
    "t-value": "1",
    "relative": "relative",
    "other": "",
}


def _recognises(source: InstrumentText) -> bool:
    return source.text.lstrip().startswith("<") and "IESTM2714" in source.text[:4096]


def _read(source: InstrumentText) -> InstrumentFile:
    root = parse_xml(source)
    bodies = [child for child in root.children if child.name == "SpectralDistribution"]
    if root.name != "IESTM2714" or len(bodies) != 1:
        fault = f"<{root.name}> with {len(bodies)} <SpectralDistribution>"
        raise InputError(source.at(root.line), fault, "<IESTM2714> with one", "Export it again.")
    quantity = bodies[0].text_of("SpectralQuantity").lower()
    if quantity not in _UNITS:
        where, expected = source.at(bodies[0].line), f"one of {', '.join(_UNITS)}"
        raise InputError(where, f"SpectralQuantity '{quantity[:40]}'", expected, "Correct <SpectralQuantity>.")
    rows = []
    for element in bodies[0].all("SpectralData"):
        where = source.at(element.line)
        wavelength = decimal_number(element.attributes.get("wavelength", ""), f"{where}, wavelength")
        rows.append((element.line, wavelength, decimal_number(element.text, where)))
    quantity = "" if quantity == "other" else quantity
    unit = _UNITS.get(quantity, "")
    spectrum = measured_spectrum(source, quantity or "value", rows, quantity=quantity, unit=unit)
    description = root.text_of("Description")
    notes = (f"Description: {' '.join(description.split())[:200]}.",) if description else ()
    return InstrumentFile(READER.name, (spectrum,), notes)


READER = SpectrumReader("tm27", "IES TM-27-14", _recognises, _read)
