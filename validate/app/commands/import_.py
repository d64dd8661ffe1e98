"""``cbox import``: spectra of an instrument's file."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from cboxlab.utils.errors import InputError

from .arguments import JsonOption
from .console import data_table, give_json, print_table, require_file, say

if TYPE_CHECKING:
    from cboxlab.scenes.spectrum_readers import MeasuredSpectrum

__all__ = ["import_"]

#: Unit of the radiances of captures and scenes.
_RADIANCE = "W m^-2 sr^-1 nm^-1"
#: Quantities whose unit is checked by the reader of per cent, or that are relative by name.
_WITHOUT_POWER = ("reflectance", "transmittance", "relative")


def import_(
    file: Annotated[
        Path,
        typer.Argument(
            help="UPRtek, Sekonic, CGATS (X-Rite, ArgyllCMS), CxF3, IES TM-27-14, PR-650, PR-655, CS-2000, Ocean "
            "Optics, or a table with a header.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="Plain CSV to write, with wavelength_nm first.", show_default=False)
    ] = None,
    column: Annotated[
        list[str] | None, typer.Option(help="Only this spectrum. May be repeated.", show_default=False)
    ] = None,
    json: JsonOption = None,
) -> None:
    """Show the spectra of an instrument's file, and write them as a plain CSV.

    Scenes, captures and cameras read the same files directly, as `file:column`, which this command takes, too.
    """
    from cboxlab.scenes.spectrum_readers import read_instrument_file
    from cboxlab.utils.faults import suggestion

    path, _, name = str(file).rpartition(":")
    if not file.exists() and path and Path(path).is_file():
        file, column = Path(path), [*(column or ()), name]
    content = read_instrument_file(file)
    spectra = {spectrum.name: spectrum for spectrum in content.spectra}
    for name in column or ():
        if name not in spectra:
            expected = f"one of {', '.join(spectra)}"
            raise InputError("--column", f"'{name}'", expected, suggestion(name, spectra))
    selected = [spectra[name] for name in dict.fromkeys(column or spectra)]
    say(f"Format: {content.format}")
    for note in content.notes:
        say(note)
    _print_spectra(selected)
    powers = [spectrum for spectrum in selected if spectrum.quantity not in _WITHOUT_POWER]
    for unit in sorted({spectrum.unit for spectrum in powers} - {"", _RADIANCE}):
        say(f"The values stay in {unit}. A lamp's radiance is read as {_RADIANCE}; in another unit it is relative.")
    if out is not None:
        _write_csv(file, out, selected)
        say(f"Table: {out}")
    give_json(json, {"format": content.format, "notes": list(content.notes), "spectra": [*map(_record, selected)]})


def _step(spectrum: MeasuredSpectrum) -> str:
    """Step of the wavelengths, or the smallest and largest, nm."""
    steps = spectrum.wavelength_nm[1:] - spectrum.wavelength_nm[:-1]
    low, high = f"{steps.min():.4g}", f"{steps.max():.4g}"
    return low if low == high else f"{low} to {high}"


def _print_spectra(spectra: list[MeasuredSpectrum]) -> None:
    table = data_table("Spectra", "column", "quantity", "unit in file", "nm", "step nm", "samples", "first", "last")
    for spectrum in spectra:
        first, last = spectrum.wavelength_nm[[0, -1]]
        table.add_row(
            spectrum.name,
            spectrum.quantity or "not stated",
            spectrum.unit or "not stated",
            f"{first:g} to {last:g}",
            _step(spectrum),
            str(spectrum.values.size),
            *(f"{value:.5g}" for value in spectrum.values[[0, -1]]),
        )
    print_table(table)
    if any(spectrum.factor != 1.0 for spectrum in spectra):
        say("Per cent were divided by 100.")


def _record(spectrum: MeasuredSpectrum) -> dict[str, object]:
    return {
        "name": spectrum.name,
        "quantity": spectrum.quantity,
        "unit": spectrum.unit,
        "factor": spectrum.factor,
        "wavelength_nm": spectrum.wavelength_nm.tolist(),
        "values": spectrum.values.tolist(),
    }


def _write_csv(file: Path, out: Path, spectra: list[MeasuredSpectrum]) -> None:
    """Write spectra of the same wavelengths as CSV.

    Raises InputError for spectra of different wavelengths, and for the file itself as output.
    """
    from cboxlab.utils.files import replacing

    if out.exists() and out.samefile(file):
        raise InputError("--out", f"{out}, the file that is read", "another file")
    first = spectra[0]
    for spectrum in spectra[1:]:
        if spectrum.wavelength_nm.tolist() != first.wavelength_nm.tolist():
            fault = f"other wavelengths in '{spectrum.name}' than in '{first.name}'"
            raise InputError("--out", fault, "columns of the same wavelengths", "Choose one with --column.")
    require_file(out)
    with replacing(out) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["wavelength_nm", *(spectrum.name for spectrum in spectra)])
        columns = [first.wavelength_nm.tolist(), *(spectrum.values.tolist() for spectrum in spectra)]
        writer.writerows([map(repr, row) for row in zip(*columns, strict=True)])
