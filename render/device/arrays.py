"""NumPy arrays for kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .libraries import dr

__all__ = ["device_array"]

#: Bytes: the widest vector register.
_ALIGNMENT = 64


def device_array(kind: type, values: ArrayLike) -> Any:
    """All ``values``, in order, as a one-dimensional Dr.Jit array of type ``kind``.

    Dr.Jit uses the memory of NumPy arrays, and compiles another kernel where it is not aligned to whole registers.
    It is aligned here, so that a computation has one kernel, which is found again on disk.
    """
    number = {
        dr.VarType.Float32: np.float32,
        dr.VarType.UInt32: np.uint32,
        dr.VarType.UInt64: np.uint64,
    }[dr.type_v(kind)]
    given = np.ravel(values)
    memory = np.empty(given.size * np.dtype(number).itemsize + _ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % _ALIGNMENT
    aligned = memory[start : len(memory) - _ALIGNMENT + start].view(number)
    aligned[:] = given
    return kind(aligned)
