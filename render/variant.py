"""Chooses the Mitsuba variant before anything else of Mitsuba is touched.

Dr.Jit compiles through the system's LLVM and aborts the whole process with releases before 16, so it is asked
first which one it has loaded.
"""

from __future__ import annotations

import os

import drjit as dr
import mitsuba as mi

from .llvm import OLDEST_RELEASE

__all__ = ["HINT", "compiled", "use"]

HINT = (
    "no LLVM 16 or newer found: rendering falls back to the slow scalar variant "
    "(Debian/Ubuntu: apt install libllvm19)"
)


def use(device: str = "cpu") -> str:
    """Activate and return the variant for ``device`` ("cpu", "cuda", or "scalar": nothing compiled).

    Without a GPU "cuda" is "cpu".
    Own integrators carry their wavelengths themselves, so the compiled variants are the monochrome ones.
    """
    if device == "cuda" and dr.has_backend(dr.JitBackend.CUDA):
        mi.set_variant("cuda_ad_mono")
    elif device != "scalar" and _llvm_works():
        mi.set_variant("llvm_ad_mono")
    else:
        mi.set_variant("scalar_spectral")
    return mi.variant()


def _llvm_works() -> bool:
    return dr.has_backend(dr.JitBackend.LLVM) and dr.detail.llvm_version()[0] >= OLDEST_RELEASE


def compiled() -> bool:
    """Whether the active variant is a compiled one (else only the stock scalar path is there)."""
    return mi.variant() is not None and not mi.variant().startswith("scalar")


if mi.variant() is None:
    use(os.environ.get("CBOX_DEVICE", "cpu"))
