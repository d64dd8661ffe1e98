"""Readers of instruments' spectra, one module per format, recognised by content."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import read_text
from cboxlab.utils.other_packages import records_in

from ._spectrum_reader import InstrumentFile, InstrumentText, MeasuredSpectrum, SpectrumReader

__all__ = [
    "InstrumentFile",
    "InstrumentText",
    "MeasuredSpectrum",
    "SpectrumReader",
    "is_plain_table",
    "read_instrument_file",
    "recognised_reader",
    "spectrum_reader_catalogue",
]

#: Largest file of an instrument, bytes: a CxF3 file of 2000 samples takes one megabyte.
_MAX_BYTES = 2**23
#: Lines of a file, at most: a spectrum in steps of 0.1 nm from 200 to 2500 nm takes 23,000.
_MAX_LINES = 100_000
#: The reader of tables that have no marks of a format.
_FALLBACK = "table"
#: First cell of the table of the project's CSV files, which are not an instrument's.
_PLAIN = re.compile(r'\s*"?\s*wavelength_nm\s*"?\s*(,|\n|$)')


@lru_cache(maxsize=1)
def spectrum_reader_catalogue() -> dict[str, SpectrumReader]:
    """All readers.

    Returns
    -------
    dict
        By identifier, the readers.
    """
    return records_in(__name__, "READER")


def is_plain_table(path: Path) -> bool:
    """Whether a file is a CSV with the first column ``wavelength_nm``.

    Such a table is read without these readers.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    bool
        True also for a text without any letter, such as an empty file. False for values with a sign of per cent.

    Raises
    ------
    InputError
        As `read_text`.
    """
    text = read_text(path, "a CSV file of spectra", of_windows=True)
    return not text.strip() or (_PLAIN.match(text) is not None and "%" not in text.partition("\n")[2])


def recognised_reader(source: InstrumentText) -> SpectrumReader:
    """The reader of a file, by the marks of its content; the ending of its name says nothing.

    Parameters
    ----------
    source
        The file.

    Returns
    -------
    SpectrumReader
        The one reader that recognises the file; that of tables if none does.

    Raises
    ------
    InputError
        If several readers recognise it.
    """
    fitting = [reader for reader in spectrum_reader_catalogue().values() if reader.recognises(source)]
    if len(fitting) > 1:
        fault = f"the marks of {' and of '.join(reader.name for reader in fitting)}"
        raise InputError(source.path, fault, "the marks of one format", "Export the spectrum again.")
    return fitting[0] if fitting else spectrum_reader_catalogue()[_FALLBACK]


def read_instrument_file(path: Path) -> InstrumentFile:
    """Spectra of an instrument's file.

    Parameters
    ----------
    path
        The file, at most 8 MiB and 100,000 lines of text in UTF-8, UTF-16 or Windows-1252.

    Returns
    -------
    InstrumentFile
        Its format and spectra, in the units that it states; per cent of reflectances and transmittances as fractions.

    Raises
    ------
    InputError
        For a file that cannot be read in exactly one way, with the line and the correction.
    """
    source = InstrumentText(path, read_text(path, "a file of spectra", largest=_MAX_BYTES, of_windows=True))
    if len(source.lines) > _MAX_LINES:
        fault, expected = f"{len(source.lines)} lines", f"at most {_MAX_LINES}"
        raise InputError(path, fault, expected, "Export the spectra alone, at wavelengths of interest.")
    try:
        return recognised_reader(source).read(source)
    except InputError as error:  # text of the file may have line ends, the message is one line
        raise InputError(error.where, " ".join(error.found.split()), error.expected, error.hint) from None
