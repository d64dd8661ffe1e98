"""Records of other packages, which are installed as entry points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from typing import Protocol, TypeVar

from .errors import InputError

__all__ = ["Identified", "add_record", "add_records", "loaded_record", "records_of_others"]


class Identified(Protocol):
    """A record of a catalogue."""

    @property
    def id(self) -> str:
        """Identifier of the record."""


Record = TypeVar("Record", bound=Identified)


def records_of_others(group: str, kind: type[Record]) -> Iterator[tuple[str, Record]]:
    """Records of other packages.

    Parameters
    ----------
    group
        Group of entry points.
    kind
        Class of the records.

    Yields
    ------
    tuple of str and Record
        Source of a record, for messages, and the record.

    Raises
    ------
    InputError
        If an entry point cannot be loaded, or is no record of this class.
    """
    for entry in entry_points(group=group):
        where = f"entry point {group}: {entry.name} = {entry.value}"
        hint = "Mend or uninstall the package that has this entry point"
        yield where, loaded_record(where, entry.load, kind, hint)


def loaded_record(where: str, load: Callable[[], object], kind: type[Record], hint: str = "") -> Record:
    """Record that other code returns.

    Parameters
    ----------
    where
        Source of the record, for the message.
    load
        The other code.
    kind
        Class of the record.
    hint
        Advice where the other code fails.

    Returns
    -------
    Record
        The record.

    Raises
    ------
    InputError
        If the other code fails, or returns no record of this class.
    """
    expected = f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"
    try:
        record = load()
    except Exception as error:  # whatever the other code raises
        raise InputError(where, f"{type(error).__name__}: {error}", expected, hint) from error
    if not isinstance(record, kind):
        raise InputError(where, f"a {type(record).__name__}", expected)
    return record


def add_record(catalogue: dict[str, Record], where: str, record: Record) -> None:
    """Add a record to a catalogue by its identifier.

    Parameters
    ----------
    catalogue
        Identifier to record; it is changed.
    where
        Source of the record, for the message.
    record
        The record.

    Raises
    ------
    InputError
        If the catalogue has a record with the identifier.
    """
    if record.id in catalogue:
        raise InputError(where, f"'{record.id}', which exists already", "another identifier")
    catalogue[record.id] = record


def add_records(catalogue: dict[str, Record], group: str, kind: type[Record]) -> None:
    """Add the records of other packages to a catalogue.

    Parameters
    ----------
    catalogue
        Identifier to record; it is changed.
    group
        Group of entry points.
    kind
        Class of the records.

    Raises
    ------
    InputError
        If an entry point cannot be loaded, is no record of this class, or has the identifier of another.
    """
    for where, record in records_of_others(group, kind):
        add_record(catalogue, where, record)
