"""CxF3 files (.cxf, ISO 17972): spectra of colour samples in XML."""

from __future__ import annotations

import re
from collections import Counter

from cboxlab.utils.errors import InputError

from ._spectrum_reader import (
    InstrumentFile,
    InstrumentText,
    MeasuredSpectrum,
    SpectrumReader,
    decimal_number,
    measured_spectrum,
    unique_names,
)
from ._xml import XmlElement, parse_xml

#: Values of a spectrum, at most: one in steps of 1 nm to 25 um has fewer.
_MAX_VALUES = 25_000
#: By element, the quantity of its values.
_QUANTITIES = {
    "ReflectanceSpectrum": "reflectance",
    "TransmittanceSpectrum": "transmittance",
    "EmissiveSpectrum": "emission",
}


def _recognises(source: InstrumentText) -> bool:
    return source.text.lstrip().startswith("<") and re.search(r"<(\w+:)?CxF[\s>]", source.text[:4096]) is not None


def _steps(root: XmlElement) -> dict[str, dict[str, str]]:
    """By identifier of a colour specification, the attributes of its range of wavelengths."""
    ranges = {}
    for specification in root.all("ColorSpecification"):
        for limits in specification.all("WavelengthRange"):
            ranges[specification.attributes.get("Id", "")] = limits.attributes
    return ranges


def _spectrum(
    source: InstrumentText, element: XmlElement, name: str, steps: dict[str, dict[str, str]]
) -> MeasuredSpectrum:
    where = source.at(element.line)
    reference = element.attributes.get("ColorSpecification", "")
    limits = {**steps.get(reference, {}), **element.attributes}
    for key in ("StartWL", "Increment"):
        if key not in limits:
            hint = f"Add Increment and StartWL to the WavelengthRange of ColorSpecification '{reference[:40]}'."
            raise InputError(where, f"no {key} for '{name[:40]}'", f"a {key} in nm", hint)
    first, step = (decimal_number(limits[key], f"{where}, {key}") for key in ("StartWL", "Increment"))
    cells = element.text.split()
    if len(cells) > _MAX_VALUES:
        raise InputError(where, f"{len(cells)} values", f"at most {_MAX_VALUES}", "Export the spectrum again.")
    values = [decimal_number(cell, where) for cell in cells]
    rows = [(element.line, first + index * step, value) for index, value in enumerate(values)]
    quantity = _QUANTITIES[element.name]
    unit = "" if quantity == "emission" else "1"
    return measured_spectrum(source, name, rows, quantity=quantity, unit=unit)


def _read(source: InstrumentText) -> InstrumentFile:
    root = parse_xml(source)
    steps = _steps(root)
    entries = [
        (item.attributes.get("Name", ""), item.attributes.get("Id", ""), element)
        for item in root.all("Object")
        for kind in _QUANTITIES
        for element in item.all(kind)
    ]
    counts = Counter(name for name, _, _ in entries)
    spectra = []
    for name, identifier, element in entries:
        unique = name and counts[name] == 1
        spectra.append(_spectrum(source, element, name if unique else f"{name} {identifier}".strip(), steps))
    return InstrumentFile(READER.name, unique_names(source, spectra))


READER = SpectrumReader("cxf", "CxF3", _recognises, _read)
