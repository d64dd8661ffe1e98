"""Files that are hostile by kind, through every reader: truncated, lying, in another encoding, or no files at all.

Run: python benchmarks/mistakes/hostile_files.py [--readers scene,points] [--json FILE] [--others]

Each reader gets files of other kinds under its name: documents whose entities or levels multiply, arrays of objects,
packed zeros, headers that count to 4 billion. It gets its sound file in some forty kinds of damage: cut at boundaries
of structures, bytes of words exchanged, words that count set to 0 and to the largest, NaN and infinity in place of
numbers, bytes that are no UTF-8, other ends of lines, a byte order mark, lines twice, nothing, packed contents, 8 GiB
of zeros, odd names, a folder, a link to itself, a pipe, a device. An input fails if anything but InputError is raised,
after 5 s, or if memory grows by more than 512 MiB. Each reader has a separate process. Prints a line for each reader
with failures, and counts; exit code 1 with any.
"""

from __future__ import annotations

import argparse
import gzip
import io
import itertools
import json
import os
import re
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from cboxlab.utils.faults import LIST_OF_FAULTS
from fuzz_readers import Reader, peak_bytes, readers

LONGEST_S, MOST_BYTES = 5.0, 512 * 2**20
#: Places at which a binary file is cut or changed, at most.
_PLACES = 24
_NUMBER = re.compile(rb"(?<![\w.])[+-]?\d+\.?\d*(?:[eE][+-]?\d+)?(?![\w.])")
_ENDS = re.compile(rb"[\n{}\[\],;>]")


def _some(positions: list[int], count: int = _PLACES) -> list[int]:
    """At most ``count`` of these, spread evenly."""
    step = max(len(positions) / count, 1.0)
    return [positions[int(k * step)] for k in range(min(count, len(positions)))]


def _is_text(content: bytes) -> bool:
    return b"\0" not in content[:4096]


def of_text(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Damage of a text."""
    for position in _some([match.end() for match in _ENDS.finditer(content)]):
        yield f"cut at {position}", content[:position]
    for match in _some_matches(content):
        for word in (b"nan", b"inf", b"-1", b"0", b"1e400", b"9" * 30, b"0x10", b"1_0", b"true", b'"1"', b""):
            yield f"{word[:9]!r} at {match.start()}", content[: match.start()] + word + content[match.end() :]
    lines = content.splitlines(keepends=True)
    for number in _some(list(range(len(lines))), 12):
        yield f"line {number} twice", b"".join([*lines[: number + 1], *lines[number:]])
    yield "all twice", content + content
    yield "latin", content.replace(b"e", b"\xe9")
    yield "no UTF-8 at the end", content + b"\xff\xfe\x80"
    yield "UTF-16", content.decode("utf-8", "replace").encode("utf-16")
    yield "marks", b"\xef\xbb\xbf\xef\xbb\xbf" + content
    yield "CR", content.replace(b"\n", b"\r")
    yield "CRLF", content.replace(b"\n", b"\r\n")
    yield "LF CR", content.replace(b"\n", b"\n\r")
    yield "NUL between", content.replace(b"\n", b"\n\0")
    yield "one line", content.replace(b"\n", b" ")
    yield "blanks of other kinds", content.replace(b" ", b"\xc2\xa0")
    yield "a million brackets", content + b"[" * 10**6


def _some_matches(content: bytes) -> list[re.Match[bytes]]:
    matches = list(_NUMBER.finditer(content))
    return [matches[k] for k in _some(list(range(len(matches))), 12)]


def of_bytes(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Damage of a binary file."""
    heads = list(range(0, min(len(content), 256), 4)) + list(range(256, len(content), max(len(content) // 32, 1)))
    for position in _some(heads, 32):
        yield f"cut at {position}", content[:position]
        for size, patterns in (
            (2, (b"\0\0", b"\xff\xff")),
            (4, (b"\0" * 4, b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0\0\xc0\x7f")),
        ):
            for word in patterns:
                yield f"{word.hex()} at {position}", content[:position] + word + content[position + size :]
    for size in (2, 4, 8):
        rounded = len(content) // size * size
        patterns = [content[k : k + size][::-1] for k in range(0, rounded, size)]
        yield f"patterns of {size} reversed", b"".join(patterns) + content[rounded:]
        yield f"head reversed by {size}", b"".join(patterns)[: 8 * size] + content[8 * size :]
    yield "all twice", content + content
    yield "zeros after it", content + bytes(10**6)
    yield "only zeros", bytes(len(content))
    yield "CRLF", content.replace(b"\n", b"\r\n")
    yield "without its head", content[16:]


def _zipped(content: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("content", content)
    return stream.getvalue()


def _bomb(start: str) -> bytes:
    """An XML document whose entities unfold to a billion letters."""
    entities = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 10))
    return f'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a0 "lol">{entities}]>{start.replace("@", "&a9;")}'.encode()


def _outside(start: str) -> bytes:
    """An XML document with an entity of another file."""
    return f'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a SYSTEM "/etc/passwd">]>{start.replace("@", "&a;")}'.encode()


def _numpy_file(array: object, archived: bool = False) -> bytes:
    stream = io.BytesIO()
    (np.savez_compressed if archived else np.save)(stream, array)  # type: ignore[operator]
    return stream.getvalue()


def _tiff(entries: list[tuple[int, int, int, int]], order: str = "<") -> bytes:
    """A TIFF with these entries (tag, type, count, value) in a folder that names itself as the next."""
    head = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 8)
    table = b"".join(struct.pack(order + "HHII", *entry) for entry in entries)
    return head + struct.pack(order + "H", len(entries)) + table + struct.pack(order + "I", 8)


def others() -> Iterator[tuple[str, bytes]]:
    """Files of kinds that no reader expects, or that only look like its own."""
    ome = '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image Name="@"/></OME>'
    cxf = '<cc:CxF xmlns:cc="http://colorexchangeformat.com/CxF3-core"><cc:Resources>@</cc:Resources></cc:CxF>'
    ies = "<IESTM2714 xmlns='iestm2714'><SpectralDistribution>@</SpectralDistribution></IESTM2714>"
    for name, start in (("OME", ome), ("CxF", cxf), ("TM-27", ies), ("SVG", "<svg>@</svg>")):
        yield f"{name} entities that multiply", _bomb(start)
        yield f"{name} entity of a file", _outside(start)
        yield f"{name} 100,000 levels", b"<a>" * 10**5
    yield "JSON 100,000 levels", b"[" * 10**5 + b"]" * 10**5
    yield "JSON 100,000 tables", b'{"a":' * 10**5 + b"1" + b"}" * 10**5
    yield "JSON number of a million digits", b'{"format": ' + b"9" * 10**6 + b"}"
    yield "TOML 100,000 levels", b"a = " + b"[" * 10**5
    yield "TOML tables that repeat", b"[[a]]\n" * 10**5
    yield "TOML of a package", b'[project]\nname = "a"\nversion = "1"\n[tool.x]\na.b.c = 1\n'
    yield "array of objects", _numpy_file(np.array([print, {"a": 1}], dtype=object))
    yield (
        "array without end",
        b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '<f8', 'fortran_order': False, 'shape': (1<<40,)}\n",
    )
    yield "archive of zeros", _numpy_file(np.zeros(2**24), archived=True)
    yield "many archives", _zipped(_zipped(_zipped(bytes(2**25))))
    yield "Parquet head and end", b"PAR1" + bytes(64) + struct.pack("<I", 2**31 - 1) + b"PAR1"
    yield "HDF5 head", b"\x89HDF\r\n\x1a\n" + b"\xff" * 512
    yield "Zarr", json.dumps({"zarr_format": 3, "node_type": "array", "shape": [2**40], "codecs": []}).encode()
    yield "Croissant", json.dumps({"@type": "Dataset", "distribution": [{"contentUrl": "/etc/passwd"}]}).encode()
    for order in "<>":
        yield f"TIFF {order} of 4 billion pixels", _tiff([(256, 4, 1, 2**32 - 1), (257, 4, 1, 2**32 - 1)], order)
        yield f"TIFF {order} of 4 billion values", _tiff([(270, 2, 2**32 - 1, 8), (273, 4, 2**31, 8)], order)
        yield f"DNG {order} without a picture", _tiff([(50706, 1, 4, 1025), (330, 4, 2**30, 8)], order)
    yield "CR2 head", b"II*\0\x10\0\0\0CR\x02\0" + b"\xff" * 64
    yield "EXR head", b"v/1\x01\x02\0\0\0channels\0chlist\0" + b"\xff" * 64
    yield "FITS head", "".join(f"{k:8}= {v:>20}".ljust(80) for k, v in _FITS.items()).ljust(2880).encode()
    yield "CGATS of a billion sets", b"CGATS.17\nNUMBER_OF_FIELDS 999999999\nNUMBER_OF_SETS 999999999\nBEGIN_DATA\n"
    yield "PLY of 4 billion corners", _PLY
    yield "OBJ of distant corners", b"v 0 0 0\nf 999999999 -999999999 1\nf " + b"1 " * 10**5
    yield "quotes", b'"' * 10**6
    yield "commas", b"," * 10**6
    yield "carriage returns", b"\r" * 10**6


#: Cards of a FITS file that states far more than it has.
_FITS = {"SIMPLE": "T", "BITPIX": 16, "NAXIS": 999, **{f"NAXIS{k}": 2**31 for k in range(1, 9)}, "END": ""}
_PLY = b"ply\nformat binary_little_endian 1.0\nelement vertex 4294967295\nproperty float x\nend_header\n\0\0\0"


def inputs(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Hostile contents by kind."""
    yield "packed", gzip.compress(content)
    yield "packed zeros", gzip.compress(bytes(2**27), 9)
    yield "zipped", _zipped(content)
    yield "zipped zeros", _zipped(bytes(2**27))
    yield "a picture's beginning", b"\x89PNG\r\n\x1a\n" + content
    yield "empty", b""
    yield "a line end", b"\n"
    yield "a NUL", b"\0"
    yield "blanks", b" " * 10**6
    yield from of_text(content) if _is_text(content) else of_bytes(content)


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _loop(path: Path) -> None:
    path.symlink_to(path)


def _nowhere(path: Path) -> None:
    path.symlink_to(path.with_name("nowhere"))


def _zero(path: Path) -> None:
    path.symlink_to("/dev/zero")


def _folder(path: Path) -> None:
    path.mkdir()


#: What lies under the file's name and is no file.
NO_FILES = {"pipe": _pipe, "loop": _loop, "nowhere": _nowhere, "zero": _zero, "folder": _folder}
#: Names of sound files: most are read.
ODD_NAMES = ("a\nb", "\x1b[31mred", "\udcff", "n" * 240, "-x", "[red]", "a b ", "\u202egnp")
#: Size of a file that is mostly a hole, bytes.
_HOLE_BYTES = 8 * 2**30
#: Memory that a reader may take before it ends, bytes.
_MEMORY_BYTES = 6 * 2**30


class _Late(BaseException):
    """A reader that took too long."""


def _late(*_: object) -> None:
    raise _Late


def fault_of(reader: Reader, path: Path, allowed: type[Exception]) -> str:
    """What is wrong with how a reader takes a file; empty if nothing is."""
    before, start = peak_bytes(), time.monotonic()
    signal.signal(signal.SIGALRM, _late)
    signal.alarm(3 * int(LONGEST_S))
    fault = ""
    try:
        reader.read(path)
    except allowed as error:
        fault = "more than one line" if "\n" in str(error).partition(LIST_OF_FAULTS)[0] else ""
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        last = traceback.extract_tb(error.__traceback__)[-1]
        fault = f"{type(error).__name__} in {Path(last.filename).name}:{last.lineno}: {str(error)[:80]}"
    finally:
        signal.alarm(0)
    if time.monotonic() - start > LONGEST_S:
        fault = fault or f"{time.monotonic() - start:.0f} s"
    if peak_bytes() - before > MOST_BYTES:
        fault = fault or f"{(peak_bytes() - before) >> 20} MiB"
    return fault


def _removed(path: Path) -> None:
    """``path`` with nothing there."""
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    else:
        path.unlink(missing_ok=True)


def cases(path: Path, damaged: bool) -> Iterator[tuple[str, Path]]:
    """Names of the kinds of hostile files, each while its file exists. damaged : whether sound files in damage, too."""
    content = path.read_bytes()
    for name, changed in itertools.chain(others(), inputs(content) if damaged else ()):
        path.write_bytes(changed)
        yield name, path
    path.write_bytes(content)
    os.truncate(path, _HOLE_BYTES)
    yield "8 GiB", path
    for name, make in NO_FILES.items():
        _removed(path)
        make(path)
        yield name, path
    _removed(path)
    for name in ODD_NAMES:
        odd = path.with_name(name + "".join(path.suffixes))
        odd.write_bytes(content)
        yield f"named {name[:9]!r}", odd
        odd.unlink()


def judge(reader: Reader, allowed: type[Exception], damaged: bool) -> tuple[int, dict[str, str]]:
    """Number of files, and faults by kind, each fault once."""
    folder = Path(tempfile.mkdtemp(prefix="hostile-"))
    sound = reader.sound(folder)
    reader.read(sound)
    count, faults = 0, {}
    for name, path in cases(sound, damaged):
        count += 1
        fault = fault_of(reader, path, allowed)
        if fault and fault not in faults.values():
            faults[name] = fault
    shutil.rmtree(folder, ignore_errors=True)
    return count, faults


def judged(reader: Reader, allowed: type[Exception], damaged: bool) -> tuple[int, dict[str, str]]:
    """The judgement of a separate process."""
    into, out = os.pipe()
    if not os.fork():
        resource.setrlimit(resource.RLIMIT_DATA, (_MEMORY_BYTES, _MEMORY_BYTES))
        os.close(into)
        try:
            result = judge(reader, allowed, damaged)
        except BaseException as error:
            result = 0, {"sound": repr(error)}
        os.write(out, json.dumps(result).encode())
        os._exit(0)
    os.close(out)
    with os.fdopen(into, "rb") as stream:
        said = stream.read()
    _, status = os.wait()
    return tuple(json.loads(said)) if said else (0, {"process": f"ended with {os.waitstatus_to_exitcode(status)}"})


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--readers", help="some of them, by comma")
    parser.add_argument("--json", type=Path, help="file of counts and faults by reader")
    parser.add_argument("--others", action="store_true", help="without sound files in damage: a few minutes")
    options = parser.parse_args()
    from cboxlab.utils.errors import InputError

    every, record = readers(), {}
    for name in options.readers.split(",") if options.readers else every:
        count, faults = judged(every[name], InputError, not options.others)
        record[name] = {"files": count, "faults": faults}
        if faults:
            print(f"{name:18s} {count:5d} files, {len(faults)} faults: {faults}", flush=True)
        if options.json:
            options.json.write_text(json.dumps(record, indent=1), encoding="utf-8")
    total, failed = sum(r["files"] for r in record.values()), sum(len(r["faults"]) for r in record.values())
    print(f"{total} files of {len(record)} readers, {failed} faults")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
