"""NumPy arrays for kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .libraries import dr

__all__ = ["device_array"]

#: Alignment of memory, bytes: the widest vector register.
_ALIGNMENT = 64


def device_array(kind: type, values: ArrayLike) -> Any:
    """One-dimensional Dr.Jit array of all values, in order.

    Dr.Jit uses the memory of NumPy arrays, and compiles another kernel where it is not aligned to whole registers. It
    is aligned here, so that a computation has one kernel, which is found again on disk.

    Parameters
    ----------
    kind
        Type of the array: a Float32, UInt32 or UInt64 of Dr.Jit.
    values
        Values of any shape, converted to that type.

    Returns
    -------
    Any
        Array of type `kind`.
    """
    number = {
        dr.VarType.Float32: np.float32,
        dr.VarType.UInt32: np.uint32,
        dr.VarType.UInt64: np.uint64,
    }[dr.type_v(kind)]
    flat = np.ravel(values)
    memory = np.empty(flat.size * np.dtype(number).itemsize + _ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % _ALIGNMENT
    aligned = memory[start : len(memory) - _ALIGNMENT + start].view(number)
    aligned[:] = flat
    return kind(aligned)
