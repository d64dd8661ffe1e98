"""The system's LLVM, through which Dr.Jit compiles.

With releases before 16 Dr.Jit aborts the process while compiling; the symbol ``LLVMGetVersion`` exists since 16. Dr.Jit
reads the path of the library from the environment variable DRJIT_LIBLLVM_PATH while it is first imported.
"""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

__all__ = ["OLDEST_RELEASE", "usable_llvm"]

#: Oldest usable release: with earlier ones Dr.Jit aborts the process.
OLDEST_RELEASE = 16

#: Folders of system libraries that are searched.
_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
)


def usable_llvm(preferred: str | None = None) -> Path | None:
    """Library of LLVM to compile with.

    Parameters
    ----------
    preferred
        Path of a library that is taken if it is usable; None for none.

    Returns
    -------
    Path | None
        This one, else the newest usable one of the system; None if there is none.
    """
    candidates = [] if preferred is None else [Path(preferred)]
    paths = [path for folder in _FOLDERS for path in Path(folder).glob("libLLVM*.so*")]
    paths += list(Path("/usr/lib").glob("llvm-*/lib/libLLVM*.so*"))
    release = {path: int(m.group(1)) for path in paths if (m := re.search(r"(?:LLVM-|\.so\.)(\d+)", path.name))}
    candidates += sorted(release, key=lambda path: release[path], reverse=True)
    for path in candidates:
        try:
            ctypes.CDLL(str(path)).LLVMGetVersion  # noqa: B018  (the look-up is the test)
        except (OSError, AttributeError):
            continue
        return path
    return None
