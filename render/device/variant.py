"""Choice of the Mitsuba variant, and with it of the device that computes.

Mitsuba's variant belongs to one thread. Importing this package chooses nothing. The first computation of a thread takes
the device of the last `use`, else that of the environment variable CBOX_DEVICE, else the CPU. A variant that the caller
has set stays.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from cboxlab.utils.errors import InputError

from .llvm import OLDEST_RELEASE, usable_llvm

__all__ = ["HINT", "compiled", "ensure", "not_compiled", "require_compiled", "use"]

_log = logging.getLogger(__name__)

#: How to install LLVM, in messages.
_INSTALL = "Debian/Ubuntu: apt install libllvm19"

#: Warning before a render without a compiled variant.
HINT = f"no LLVM 16 or newer found: rendering falls back to the slow scalar variant ({_INSTALL})"

#: Device of the last `use`; empty before the first.
_devices: list[str] = []
#: Held while Dr.Jit and Mitsuba are imported.
_import_lock = threading.Lock()
#: `active` is True in threads that have a variant.
_thread = threading.local()


def use(device: str = "cpu") -> str:
    """Activate the variant for a device.

    It holds for this thread, and for others that compute for the first time later. The compiled variants are
    monochrome, since this package's integrators handle wavelengths themselves. Dr.Jit aborts the process with LLVM
    releases before 16, so the loaded release is checked first.

    Parameters
    ----------
    device
        "cpu", "cuda" (without a GPU the same as "cpu"), or "scalar" (nothing compiled).

    Returns
    -------
    str
        Name of the variant; a scalar one if nothing can be compiled.
    """
    _import_libraries()
    import drjit as dr
    import mitsuba as mi

    _devices[:] = [device]
    works = dr.has_backend(dr.JitBackend.LLVM) and dr.detail.llvm_version()[0] >= OLDEST_RELEASE
    if device == "cuda" and dr.has_backend(dr.JitBackend.CUDA):
        mi.set_variant("cuda_ad_mono")
    elif device != "scalar" and works:
        mi.set_variant("llvm_ad_mono")
    else:
        mi.set_variant("scalar_spectral")
    _log.info("device '%s': Mitsuba's variant %s", device, mi.variant())
    return mi.variant()


def ensure() -> None:
    """Activate a variant in this thread unless one is active."""
    if getattr(_thread, "active", False):
        return
    _import_libraries()
    import mitsuba as mi

    if mi.variant() is None:
        use(_devices[0] if _devices else os.environ.get("CBOX_DEVICE", "cpu"))
    _thread.active = True


def compiled() -> bool:
    """Whether the active variant is compiled.

    Otherwise only Mitsuba's scalar path integrator is available.

    Returns
    -------
    bool
        True for a compiled variant.
    """
    ensure()
    return not sys.modules["mitsuba"].variant().startswith("scalar")


def not_compiled(where: str) -> InputError:
    """Error for a computation that the scalar variant cannot do.

    Parameters
    ----------
    where
        The computation or option that needs a compiled variant.

    Returns
    -------
    InputError
        The error, to be raised.
    """
    return InputError(where, "no compiled variant", "LLVM 16 or newer, or a GPU", _INSTALL)


def require_compiled(where: str) -> None:
    """Require a compiled variant.

    Parameters
    ----------
    where
        The computation or option that needs it.

    Raises
    ------
    InputError
        If the active variant is a scalar one.
    """
    if not compiled():
        raise not_compiled(where)


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Delay Ctrl-C until the end of the block.

    Dr.Jit loses an interrupt during its import, and is then half imported.
    """
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
    """Import Dr.Jit with a usable LLVM, and Mitsuba.

    Dr.Jit takes the path of LLVM from the environment, which is restored.
    """
    with _import_lock:
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
