"""Radiance pictures written as Radiance's own programs do: cut off to eight bits a channel, flat."""

from pathlib import Path

import numpy as np


def write_rgbe(path: Path, rgb, header: str = "") -> Path:
    """R, G, B (y, x, 3); what is below 0 is cut off. header : further lines, each with its end."""
    rgb = np.maximum(rgb, 0.0)
    exponent = np.frexp(rgb.max(axis=-1, keepdims=True))[1]
    mantissa = np.floor(np.ldexp(rgb, 8 - exponent)).astype(np.uint8)
    pixels = np.concatenate([mantissa, (exponent + 128).astype(np.uint8)], axis=-1)
    rows, columns = rgb.shape[:2]
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n{header}\n-Y {rows} +X {columns}\n"
    path.write_bytes(head.encode() + pixels.tobytes())
    return path
