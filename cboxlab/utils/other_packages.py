"""Code of other packages, loaded from entry points and run without harm to the command."""

from __future__ import annotations

import os
import re
import sys
import threading
import time
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial, wraps
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pkgutil import iter_modules
from typing import Any, Protocol, TextIO, TypeVar

from .errors import InputError
from .progress import Cancelled

__all__ = [
    "checked_function",
    "checked_generator",
    "guarded",
    "is_identifier",
    "is_tuple_of",
    "loaders_of",
    "records_in",
    "require",
    "require_fields",
    "with_others",
]

#: Hint at a fault of another package.
_HINT = "Mend or uninstall the package that it belongs to"
#: Longest import without a warning, s: the packages that numerical code imports take 1 to 3 s.
_LONGEST_IMPORT_S = 5.0

#: Identifiers: small letters, digits and hyphens, as names of files and in tables.
_IDENTIFIER = re.compile(r"[a-z0-9][a-z0-9-]{0,63}")

#: Mark of a generator's end.
_END = object()

Kind = TypeVar("Kind")


class Record(Protocol):
    """Entry of a catalogue, such as an effect or a renderer."""

    @property
    def id(self) -> str:
        """Identifier in the catalogue."""


Entry = TypeVar("Entry", bound=Record)


class _Surroundings:
    """Standard output and working directory while code of other packages runs."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running = 0
        self._output: TextIO = sys.stdout
        self._folder: str | None = None

    def enter(self) -> None:
        """Print to standard error from here on, so that results on standard output stay clear."""
        with self._lock:
            if not self._running:
                self._folder = _working_folder()
                self._output, sys.stdout = sys.stdout, sys.stderr
            self._running += 1

    def leave(self) -> None:
        """Restore the working directory, and standard output if no other thread needs it."""
        with self._lock:
            self._running -= 1
            if not self._running:
                sys.stdout = self._output
            if self._folder is not None and _working_folder() != self._folder:
                with suppress(OSError):
                    os.chdir(self._folder)


def _working_folder() -> str | None:
    """The working directory; None if it was removed."""
    try:
        return os.getcwd()
    except OSError:
        return None


_surroundings = _Surroundings()


@contextmanager
def guarded(where: str, expected: str) -> Iterator[None]:
    """Run code of another package in the block.

    Whatever it prints goes to standard error, and the working directory is restored after it.

    Parameters
    ----------
    where
        The entry point, for messages.
    expected
        Words for what the code should do or be.

    Yields
    ------
    None
        In the block the code runs.

    Raises
    ------
    InputError
        For any exception of the code, including an attempt to end the program. Ctrl-C, a cancelled run and a lack of
        memory pass.
    """
    _surroundings.enter()
    try:
        yield
    except (KeyboardInterrupt, Cancelled, MemoryError, InputError):
        raise
    except SystemExit as ended:
        raise InputError(where, f"an attempt to end the program (exit code {ended.code})", expected, _HINT) from None
    except BaseException as error:
        message = " ".join(str(error).split())[:200]
        raise InputError(where, f"{type(error).__name__}: {message}", expected, _HINT) from error
    finally:
        _surroundings.leave()


def records_in(package: str, attribute: str, helpers: Collection[str] = ()) -> dict[str, Any]:
    """Records of the modules of a package.

    Parameters
    ----------
    package
        Name of the package.
    attribute
        Name of the record in each module.
    helpers
        Modules without a record. Modules whose names begin with an underscore have none either.

    Returns
    -------
    dict
        The records by identifier, in the alphabetical order of their modules.
    """
    names = [module.name for module in iter_modules(import_module(package).__path__)]
    records = [
        getattr(import_module(f"{package}.{name}"), attribute)
        for name in names
        if not name.startswith("_") and name not in helpers
    ]
    return {record.id: record for record in records}


def loaders_of(group: str, kind: type[Kind]) -> list[tuple[str, Callable[[], Kind]]]:
    """Entry points of a group in all installed packages.

    Parameters
    ----------
    group
        Name of the group.
    kind
        Type that their records have.

    Returns
    -------
    list of (str, function)
        The entry point for messages, and the function that loads its record. It raises InputError if the record cannot
        be imported or is of another type, and warns (RuntimeWarning) if the import takes more than 5 s.
    """
    return [
        (where, partial(_loaded, where, entry, kind))
        for entry in entry_points(group=group)
        for where in [f"entry point {group}: {entry.name} = {entry.value}"]
    ]


def with_others(
    records: Mapping[str, Entry],
    loaders: Collection[tuple[str, Callable[[], Entry]]],
    checked: Callable[[Entry, str], Entry],
) -> dict[str, Entry]:
    """Catalogue with records of other packages.

    Parameters
    ----------
    records
        Records by identifier.
    loaders
        Sources of further records, for messages, and the functions that load them.
    checked
        Function of a record and its source. It returns the record as it is used, and raises InputError for a faulty
        one.

    Returns
    -------
    dict
        All records by identifier, the further ones at the end.

    Raises
    ------
    InputError
        For a record that cannot be loaded, is faulty, or has the identifier of another.
    """
    catalogue = dict(records)
    for where, load in loaders:
        record = checked(load(), where)
        if record.id in catalogue:
            raise InputError(where, f"'{record.id}', which is there already", "another identifier")
        catalogue[record.id] = record
    return catalogue


def _loaded(where: str, entry: EntryPoint, kind: type[Kind]) -> Kind:
    """Record of an entry point."""
    expected = _with_article(kind)
    start = time.monotonic()
    with guarded(where, expected):
        record = entry.load()
    if (seconds := time.monotonic() - start) > _LONGEST_IMPORT_S:
        warnings.warn(f"{where}: its import took {seconds:.0f} s, in every command", RuntimeWarning, stacklevel=2)
    if not isinstance(record, kind):
        raise InputError(where, f"a {type(record).__name__}", expected, _HINT)
    return record


def require(sound: bool, where: str, fault: str, expected: str) -> None:
    """Check something of another package.

    Parameters
    ----------
    sound
        Whether it is as it should be.
    where
        The entry point, for messages.
    fault
        Words for what it is.
    expected
        Words for what it should be.

    Raises
    ------
    InputError
        If it is not sound.
    """
    if not sound:
        raise InputError(where, fault, expected, _HINT)


def is_identifier(value: object) -> bool:
    """Whether a value is a text of 1 to 64 small letters, digits and hyphens.

    Parameters
    ----------
    value
        The value.

    Returns
    -------
    bool
        True for an identifier.
    """
    return isinstance(value, str) and _IDENTIFIER.fullmatch(value) is not None


def is_tuple_of(kind: type, values: object) -> bool:
    """Whether a value is a tuple whose items have one type.

    Parameters
    ----------
    kind
        The type.
    values
        The value.

    Returns
    -------
    bool
        True for such a tuple, an empty one included.
    """
    return isinstance(values, tuple) and all(isinstance(value, kind) for value in values)


def require_fields(where: str, record: object, sound: Mapping[str, bool]) -> None:
    """Check the fields of another package's record.

    Parameters
    ----------
    where
        The entry point, for messages.
    record
        The record.
    sound
        Whether a field is sound, by its name.

    Raises
    ------
    InputError
        For the first field that is not.
    """
    name = _with_article(type(record))
    for field, right in sound.items():
        article = "" if field.endswith("s") else "a "
        require(right, where, f"{name} with {article}wrong {field}", f"{name} as the manual describes it")


def _with_article(kind: type) -> str:
    return f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"


def checked_function(
    function: Callable[..., Any], where: str, expected: str, check: Callable[..., Any]
) -> Callable[..., Any]:
    """Function of another package whose faults are InputErrors.

    Parameters
    ----------
    function
        The package's function.
    where
        The entry point, for messages.
    expected
        Words for what the function should give.
    check
        Function of the result and of the arguments. It gives the result as it is used, and raises InputError for a
        wrong one.

    Returns
    -------
    Callable
        Function of the same arguments.
    """

    @wraps(function)
    def call(*arguments: Any) -> Any:
        with guarded(where, expected):
            return check(function(*arguments), *arguments)

    return call


def checked_generator(
    function: Callable[..., Iterator[Any]], where: str, expected: str, check: Callable[..., Any]
) -> Callable[..., Iterator[Any]]:
    """Generator of another package whose faults are InputErrors.

    Parameters
    ----------
    function
        The package's generator function.
    where
        The entry point, for messages.
    expected
        Words for what the generator should yield.
    check
        Function of one item and of the arguments. It gives the item as it is used, and raises InputError for a wrong
        one.

    Returns
    -------
    Callable
        Generator function of the same arguments.
    """

    @wraps(function)
    def generate(*arguments: Any) -> Iterator[Any]:
        with guarded(where, expected):
            items = iter(function(*arguments))
        while True:
            with guarded(where, expected):
                item = next(items, _END)
                checked = item if item is _END else check(item, *arguments)
            if checked is _END:
                return
            yield checked

    return generate
