"""Writing of files and folders that are either complete or absent, and their origin."""

from __future__ import annotations

import errno
import glob
import hashlib
import io
import logging
import os
import platform
import shlex
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path

from .errors import InputError
from .progress import checkpoint

__all__ = [
    "folder_lock",
    "load_checked",
    "origin",
    "replacing",
    "replacing_folder",
    "store_checked",
    "temporary_file",
    "temporary_folder",
    "this_command",
    "writing_hdf5",
]

_log = logging.getLogger(__name__)

#: Bytes of a checksum between two checkpoints: some hundredths of a second.
_CHUNK_BYTES = 1 << 24


def _public(path: Path, mode: int) -> None:
    """Give a temporary file the permissions of any other new file (temporary files are private)."""
    mask = os.umask(0)
    os.umask(mask)
    path.chmod(mode & ~mask)


def _remove_leftovers(path: Path) -> None:
    """Remove temporary files and folders for `path` of processes that have ended.

    Only names of this machine count.
    """
    start = f".{path.name}-unfinished-{platform.node()}-"
    for leftover in path.parent.glob(glob.escape(start) + "*"):
        owner = leftover.name.removeprefix(start).split("-")[0]
        if owner.isdigit() and not _running(int(owner)):
            shutil.rmtree(leftover, ignore_errors=True) if leftover.is_dir() else leftover.unlink(missing_ok=True)


def _running(process: int) -> bool:
    """Whether a process of this machine runs; True if that cannot be found out."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def _temporary_prefix(path: Path) -> str:
    """Beginning of the name of a temporary file for `path`, in a folder that is made.

    It names machine and process, so that the leftovers of a killed process are recognised; those are removed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(path)
    return f".{path.name}-unfinished-{platform.node()}-{os.getpid()}-"


@contextmanager
def temporary_file(path: Path, suffix: str) -> Iterator[Path]:
    """A temporary file in the folder of `path`, removed after the block.

    The file of a killed process is removed by the next such block. An OSError of the block names `path`, not the
    temporary file or no file at all.

    Parameters
    ----------
    path
        File that the temporary one is for.
    suffix
        End of the name, such as ".nc".

    Yields
    ------
    Path
        The empty temporary file.
    """
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
    """A folder for temporary files, removed after the block.

    The folder of a killed process is removed by the next such block.

    Yields
    ------
    Path
        The empty folder.
    """
    name = tempfile.mkdtemp(prefix=_temporary_prefix(Path(tempfile.gettempdir()) / "cboxlab"))
    try:
        yield Path(name)
    finally:
        shutil.rmtree(name, ignore_errors=True)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file to write to, which becomes `path` only if the block succeeds.

    It is in the same folder, so that the change is one step for other processes. An OSError of the block names `path`.

    Parameters
    ----------
    path
        File to write; an existing one is replaced.

    Yields
    ------
    Path
        The temporary file.
    """
    path = Path(path)
    with temporary_file(path, path.suffix) as temporary:
        yield temporary
        _public(temporary, 0o666)
        temporary.replace(path)


@contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """A temporary folder to fill, which becomes `path` only if the block succeeds.

    Parameters
    ----------
    path
        Folder to write: a new or an empty one.

    Yields
    ------
    Path
        The temporary folder, next to `path`.

    Raises
    ------
    InputError
        If `path` exists and is not an empty folder, since existing files are not overwritten. If it is the current
        folder.
    """
    path = Path(path)
    exists_error = InputError(path, "something that exists already", "a new or empty folder", "Name another one.")
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise exists_error
    if path.resolve() == Path.cwd():  # it cannot be replaced
        raise InputError(path, "the current folder", "a new or empty folder", "Name another one.")
    temporary = Path(tempfile.mkdtemp(prefix=_temporary_prefix(path), dir=path.parent))
    try:
        yield temporary
        _public(temporary, 0o777)
        try:
            temporary.replace(path)
        except OSError as fault:  # another writer was first
            if fault.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                raise exists_error from fault
            raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def writing_hdf5(path: Path) -> Iterator[io.RawIOBase]:
    """An open file for ``h5netcdf`` or ``xarray``, which becomes `path` if the block succeeds.

    The HDF5 library crashes the process when its own writing fails (1.14: a segmentation fault at closing), so it
    writes through Python. A failure is reported only after it has closed the file.

    Parameters
    ----------
    path
        File to write; an existing one is replaced.

    Yields
    ------
    RawIOBase
        The open file.

    Raises
    ------
    OSError
        If not all bytes were written; its file name is `path`.
    """
    path = Path(path)
    with replacing(path) as temporary:
        with temporary.open("w+b", buffering=0) as raw:
            file = _ErrorKeepingFile(raw)
            try:
                yield file
            finally:
                file.close()
        if file.fault is not None:
            raise OSError(file.fault.errno, file.fault.strerror, str(path))


class _ErrorKeepingFile(io.RawIOBase):
    """A file whose writing never fails: refused bytes are lost, and the first error is `fault`."""

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


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Exclusive use of a folder for the block; other processes that lock the same folder wait.

    The lock is on the folder itself (flock), so no lock file is left in it, and a killed process holds none. On a file
    system without locks the block runs unlocked.

    Parameters
    ----------
    folder
        An existing folder.

    Yields
    ------
    None
        While the lock is held.
    """
    import fcntl  # on Unix only

    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def store_checked(path: Path, key: str, content: bytes | memoryview) -> None:
    """Write content with a checksum over a key and itself, for `load_checked`.

    Parameters
    ----------
    path
        File to write.
    key
        Everything from which the content was computed.
    content
        The content.
    """
    with replacing(path) as temporary, temporary.open("wb") as stream:
        stream.write(_checksum(key, content))
        stream.write(content)


def load_checked(path: Path, key: str) -> bytes | None:
    """Content that `store_checked` wrote with the same key.

    Parameters
    ----------
    path
        The file.
    key
        Everything from which the content should have been computed.

    Returns
    -------
    bytes | None
        The content; None if there is no such file, or one of another key or with a changed bit.
    """
    try:
        stored = path.read_bytes() if path.is_file() else None  # reading a pipe or a device might never end
    except (OSError, MemoryError):
        stored = None
    if stored is None:
        return None
    size = hashlib.sha256().digest_size
    content = memoryview(stored)[size:]
    if stored[:size] != _checksum(key, content):
        _log.info("stored result is damaged or of another key, and is computed again: %s", path)
        return None
    return bytes(content)


def _checksum(key: str, content: bytes | memoryview) -> bytes:
    """SHA-256 of key and content."""
    digest = hashlib.sha256(key.encode())
    view = memoryview(content)
    for first in range(0, len(view), _CHUNK_BYTES):
        checkpoint()
        digest.update(view[first : first + _CHUNK_BYTES])
    return digest.digest()


def this_command() -> str:
    """Command of this process as typed.

    Returns
    -------
    str
        Program and arguments, quoted for a shell; in a program that uses this library, the command of that program.
    """
    name, *arguments = sys.argv or [""]
    program = Path(name)
    program_name = f"python -m {program.parent.name}" if program.name == "__main__.py" else program.name
    return f"{program_name} {shlex.join(arguments)}".strip()


def origin(**further: str) -> dict[str, str]:
    """Attributes that state the origin of a file.

    Parameters
    ----------
    further
        Further attributes.

    Returns
    -------
    dict[str, str]
        These, `cboxlab_version` and `command`.
    """
    return {**further, "cboxlab_version": version("cboxlab"), "command": this_command()}
