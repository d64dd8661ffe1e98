"""Finds the system's LLVM for Dr.Jit, which compiles through it.

Releases before 16 abort the whole process while they compile; the symbol ``LLVMGetVersion`` exists from 16 on.
Dr.Jit reads its choice once, when it is first imported: that is why the package chooses before any of it is.
"""

from __future__ import annotations

import ctypes
import os
import re
from pathlib import Path

__all__ = ["OLDEST_RELEASE", "choose_llvm"]

OLDEST_RELEASE = 16

_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
)


def choose_llvm() -> None:
    """Have Dr.Jit load a library that works, if there is one: that of DRJIT_LIBLLVM_PATH, else the newest."""
    candidates = [Path(os.environ["DRJIT_LIBLLVM_PATH"])] if "DRJIT_LIBLLVM_PATH" in os.environ else []
    found = [path for folder in _FOLDERS for path in Path(folder).glob("libLLVM*.so*")]
    found += list(Path("/usr/lib").glob("llvm-*/lib/libLLVM*.so*"))
    release = {
        path: int(m.group(1)) for path in found if (m := re.search(r"(?:LLVM-|\.so\.)(\d+)", path.name))
    }
    candidates += sorted(release, key=lambda path: release[path], reverse=True)
    for path in candidates:
        try:
            ctypes.CDLL(str(path)).LLVMGetVersion  # noqa: B018  (the look-up is the test)
        except (OSError, AttributeError):
            continue
        os.environ["DRJIT_LIBLLVM_PATH"] = str(path)
        return
