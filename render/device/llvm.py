"""Finds the system's LLVM for Dr.Jit, which compiles through it.

With releases before 16 Dr.Jit aborts the process while compiling; the symbol ``LLVMGetVersion`` exists since 16.
Dr.Jit reads the path of the library from the environment variable DRJIT_LIBLLVM_PATH while it is first imported.
"""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

__all__ = ["OLDEST_RELEASE", "usable_llvm"]

OLDEST_RELEASE = 16

_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
)


def usable_llvm(named: str | None = None) -> Path | None:
    """The library to compile with: ``named`` where it is usable, else the newest one found; None if there is none."""
    candidates = [] if named is None else [Path(named)]
    found = [path for folder in _FOLDERS for path in Path(folder).glob("libLLVM*.so*")]
    found += list(Path("/usr/lib").glob("llvm-*/lib/libLLVM*.so*"))
    release = {path: int(m.group(1)) for path in found if (m := re.search(r"(?:LLVM-|\.so\.)(\d+)", path.name))}
    candidates += sorted(release, key=lambda path: release[path], reverse=True)
    for path in candidates:
        try:
            ctypes.CDLL(str(path)).LLVMGetVersion  # noqa: B018  (the look-up is the test)
        except (OSError, AttributeError):
            continue
        return path
    return None
