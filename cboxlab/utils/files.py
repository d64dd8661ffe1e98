"""Writing files and folders so that they are either complete or absent, and say where they come from."""

from __future__ import annotations

import errno
import glob
import hashlib
import io
import os
import platform
import shlex
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path

from .errors import InputError

__all__ = [
    "beside",
    "keep",
    "kept",
    "origin",
    "replacing",
    "replacing_folder",
    "temporary_folder",
    "this_command",
    "writing_hdf5",
]


def _public(path: Path, mode: int) -> None:
    """Give a temporary file the permissions of any other new file (temporary files are private)."""
    mask = os.umask(0)
    os.umask(mask)
    path.chmod(mode & ~mask)


def _remove_leftovers(path: Path) -> None:
    """Remove temporary files and folders for ``path`` whose process, on this machine, is gone."""
    start = f".{path.name}-unfinished-{platform.node()}-"
    for left in path.parent.glob(glob.escape(start) + "*"):
        owner = left.name.removeprefix(start).split("-")[0]
        if owner.isdigit() and not _running(int(owner)):
            shutil.rmtree(left, ignore_errors=True) if left.is_dir() else left.unlink(missing_ok=True)


def _running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def _temporary_prefix(path: Path) -> str:
    """Names say which process on which machine writes, so that what a killed one leaves is recognised."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(path)
    return f".{path.name}-unfinished-{platform.node()}-{os.getpid()}-"


@contextmanager
def beside(path: Path, suffix: str) -> Iterator[Path]:
    """A temporary file beside ``path``, removed after the block; of a killed process, by the next such block."""
    handle, name = tempfile.mkstemp(prefix=_temporary_prefix(path), suffix=suffix, dir=path.parent)
    os.close(handle)
    try:
        yield Path(name)
    except OSError as error:
        if error.filename in (None, name):
            error.filename = str(path)
        raise
    finally:
        Path(name).unlink(missing_ok=True)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder for temporary files, removed after the block; of a killed process, by the next such block."""
    name = tempfile.mkdtemp(prefix=_temporary_prefix(Path(tempfile.gettempdir()) / "cboxlab"))
    try:
        yield Path(name)
    finally:
        shutil.rmtree(name, ignore_errors=True)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary name beside ``path`` to write to; it becomes ``path`` only if the block succeeds.

    What a killed process has left beside ``path`` is removed. An OSError of the block names ``path``, not the temporary
    file or no file at all.
    """
    path = Path(path)
    with beside(path, path.suffix) as temporary:
        yield temporary
        _public(temporary, 0o666)
        temporary.replace(path)


@contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """A temporary folder beside ``path`` to fill; it becomes ``path`` only if the block succeeds.

    Raises InputError if ``path`` exists and is not an empty folder: existing files are not overwritten.
    """
    path = Path(path)
    taken = InputError(path, "something that exists already", "a new or empty folder", "Name another one.")
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise taken
    temporary = Path(tempfile.mkdtemp(prefix=_temporary_prefix(path), dir=path.parent))
    try:
        yield temporary
        _public(temporary, 0o777)
        try:
            temporary.replace(path)
        except OSError as fault:  # another writer was first
            if fault.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                raise taken from fault
            raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def writing_hdf5(path: Path) -> Iterator[io.RawIOBase]:
    """An open file for ``h5netcdf`` or ``xarray``; it becomes ``path`` if the block succeeds and all bytes are written.

    Raises OSError, with ``path`` as its file name, where the disk did not take them. The HDF5 library crashes the
    process when its own writing fails (1.14: a segmentation fault at closing), so that it writes through Python.
    """
    path = Path(path)
    with replacing(path) as temporary:
        with temporary.open("w+b", buffering=0) as raw:
            file = _Patient(raw)
            try:
                yield file
            finally:
                file.close()
        if file.fault is not None:
            raise OSError(file.fault.errno, file.fault.strerror, str(path))


class _Patient(io.RawIOBase):
    """A file whose writing never fails: what the disk refuses is lost, its first error is ``fault``."""

    def __init__(self, file: io.FileIO) -> None:
        super().__init__()
        self._file = file
        self.fault: OSError | None = None

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def readinto(self, buffer: memoryview) -> int | None:  # type: ignore[override]
        return self._file.readinto(buffer)

    def truncate(self, size: int | None = None) -> int:
        try:
            return self._file.truncate(size)
        except OSError as fault:
            self.fault = self.fault or fault
            return size or 0

    def write(self, content: memoryview) -> int:  # type: ignore[override]
        rest = memoryview(content).cast("B")
        while rest and self.fault is None:
            try:
                rest = rest[self._file.write(rest) :]
            except OSError as fault:
                self.fault = fault
        return len(content)


def keep(path: Path, key: str, content: bytes | memoryview) -> None:
    """Write ``content`` with a checksum over ``key`` and itself, for ``kept``. key : what it was made from."""
    with replacing(path) as temporary, temporary.open("wb") as stream:
        stream.write(_checksum(key, content))
        stream.write(content)


def kept(path: Path, key: str) -> bytes | None:
    """What ``keep`` wrote with the same ``key``; None if there is no such file, or another key or a changed bit."""
    try:
        stored = path.read_bytes()
    except OSError:
        return None
    size = hashlib.sha256().digest_size
    content = memoryview(stored)[size:]
    return bytes(content) if stored[:size] == _checksum(key, content) else None


def _checksum(key: str, content: bytes | memoryview) -> bytes:
    digest = hashlib.sha256(key.encode())
    digest.update(content)
    return digest.digest()


def this_command() -> str:
    """The command of this process as typed; for a library's caller that of its own program."""
    name, *arguments = sys.argv or [""]
    program = Path(name)
    shown = f"python -m {program.parent.name}" if program.name == "__main__.py" else program.name
    return f"{shown} {shlex.join(arguments)}".strip()


def origin(**further: str) -> dict[str, str]:
    """Attributes of a file, all of them text: ``further`` ones, ``cboxlab_version`` and ``command``."""
    return {**further, "cboxlab_version": version("cboxlab"), "command": this_command()}
