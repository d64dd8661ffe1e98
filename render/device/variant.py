"""Which Mitsuba variant computes, and with it on which device.

Mitsuba's variant belongs to one thread. Nothing is chosen by importing this package: the first computation of a thread
takes the device of the last ``use``, else that of the environment variable CBOX_DEVICE, else the CPU. A variant that
the caller has set stays.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from cboxlab.utils.errors import InputError

from .llvm import OLDEST_RELEASE, usable_llvm

__all__ = ["HINT", "compiled", "ensure", "not_compiled", "require_compiled", "use"]

_INSTALL = "Debian/Ubuntu: apt install libllvm19"

HINT = f"no LLVM 16 or newer found: rendering falls back to the slow scalar variant ({_INSTALL})"

_used: list[str] = []
_importing, _thread = threading.Lock(), threading.local()


def use(device: str = "cpu") -> str:
    """Activate and return the variant for ``device`` ("cpu", "cuda", or "scalar": nothing compiled).

    It holds for this thread, and for others that compute for the first time later. Without a GPU "cuda" means "cpu".
    The compiled variants are monochrome, since this package's integrators handle wavelengths themselves. Dr.Jit aborts
    the process with LLVM releases before 16, so the loaded release is checked first.
    """
    _import_libraries()
    import drjit as dr
    import mitsuba as mi

    _used[:] = [device]
    works = dr.has_backend(dr.JitBackend.LLVM) and dr.detail.llvm_version()[0] >= OLDEST_RELEASE
    if device == "cuda" and dr.has_backend(dr.JitBackend.CUDA):
        mi.set_variant("cuda_ad_mono")
    elif device != "scalar" and works:
        mi.set_variant("llvm_ad_mono")
    else:
        mi.set_variant("scalar_spectral")
    return mi.variant()


def ensure() -> None:
    """Activate a variant in this thread unless one is active."""
    if getattr(_thread, "active", False):
        return
    _import_libraries()
    import mitsuba as mi

    if mi.variant() is None:
        use(_used[0] if _used else os.environ.get("CBOX_DEVICE", "cpu"))
    _thread.active = True


def compiled() -> bool:
    """Whether the active variant is compiled; otherwise only Mitsuba's scalar path integrator is available."""
    ensure()
    return not sys.modules["mitsuba"].variant().startswith("scalar")


def not_compiled(where: str) -> InputError:
    """What to raise where the scalar variant is not enough. where : the computation or option that needs more."""
    return InputError(where, "no compiled variant", "LLVM 16 or newer, or a GPU", _INSTALL)


def require_compiled(where: str) -> None:
    """Raise ``not_compiled`` unless the active variant is compiled."""
    if not compiled():
        raise not_compiled(where)


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Ctrl-C takes effect after the block: Dr.Jit loses one during its import, and is then half imported."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pressed: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
    if pressed:
        signal.raise_signal(signal.SIGINT)


def _import_libraries() -> None:
    """Import Dr.Jit with a usable LLVM: it takes the path from the environment, which is then as it was before."""
    with _importing:
        if "drjit" in sys.modules:
            return
        before = os.environ.get("DRJIT_LIBLLVM_PATH")
        library = usable_llvm(before)
        if library is not None:
            os.environ["DRJIT_LIBLLVM_PATH"] = str(library)
        try:
            with _interrupts_later():
                import drjit as dr
                import mitsuba  # noqa: F401

            dr.has_backend(dr.JitBackend.LLVM)  # waits until it is loaded
        finally:
            if before is None:
                os.environ.pop("DRJIT_LIBLLVM_PATH", None)
            else:
                os.environ["DRJIT_LIBLLVM_PATH"] = before
