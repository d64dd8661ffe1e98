"""Chooses the Mitsuba variant before anything else of Mitsuba is touched.

Dr.Jit compiles through the system's LLVM and aborts the whole process with releases before 16, so the
library is probed first: the symbol ``LLVMGetVersion`` exists from release 16 on.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import re
from pathlib import Path

import drjit as dr
import mitsuba as mi

__all__ = ["HINT", "compiled", "find_llvm", "use"]

HINT = (
    "no LLVM 16 or newer found: rendering falls back to the slow scalar variant "
    "(Debian/Ubuntu: apt install libllvm19)"
)

_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
)


def find_llvm() -> str | None:
    """Path of the newest LLVM library of release 16 or later, or None. DRJIT_LIBLLVM_PATH comes first."""
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
        return str(path)
    return None


def use(device: str = "cpu") -> str:
    """Activate and return the variant for ``device`` ("cpu", "cuda", or "scalar": nothing compiled).

    Without a GPU "cuda" is "cpu".
    Own integrators carry their wavelengths themselves, so the compiled variants are the monochrome ones.
    """
    if device == "cuda" and dr.has_backend(dr.JitBackend.CUDA):
        mi.set_variant("cuda_ad_mono")
    elif device != "scalar" and (library := find_llvm()):
        os.environ["DRJIT_LIBLLVM_PATH"] = library
        mi.set_variant("llvm_ad_mono")
    else:
        mi.set_variant("scalar_spectral")
    return mi.variant()


def compiled() -> bool:
    """Whether the active variant is a compiled one (else only the stock scalar path is there)."""
    return mi.variant() is not None and not mi.variant().startswith("scalar")


if mi.variant() is None:
    use(os.environ.get("CBOX_DEVICE", "cpu"))
