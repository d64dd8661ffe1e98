"""Data of a comparison for the viewer: plain values, ready for JSON."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import matplotlib
import numpy as np
from cboxlab.calibration.instrument import Mask, band_centres, cell_means
from cboxlab.utils.errors import InputError
from numpy.typing import ArrayLike, NDArray

from ...compare import COLOUR_DIFFERENCES, Comparison, Validation, srgb_matrix
from .flip import FLIP_LACKING, flip_map
from .light import filter_curves, light_parts, pixel_spectra

__all__ = ["encoded", "flip_data", "picture_data", "viewer_data"]

#: Most numbers of an array that is stored in 32 bits; larger arrays have 16 bits, so that a report stays small.
_MAX_EXACT_NUMBERS = 1 << 19

#: Most numbers (pixels times bands) of a picture at full size; larger ones are shown as means of square blocks.
_MAX_NUMBERS = 1 << 21

#: Step in which signals of large arrays are stored, over the median sigma.
_SIGNAL_STEP = 1 / 32

#: Step in which sigmas of large arrays are stored, over the median sigma.
_SIGMA_STEP = 1 / 128

#: Step in which spectra and shares of light of large arrays are stored, over the largest value.
_LIGHT_STEP = 1 / 4096

#: Colour stops of a scale; the viewer interpolates between them.
_NUM_STOPS = 33


def encoded(values: ArrayLike, step: float = 0.0) -> dict[str, Any]:
    """Array for the viewer: deflated bytes as base64 text, with shape and type.

    Integers are stored as they are (u1, i2), other numbers in 32 bits. Arrays of more than half a million numbers have
    16 bits, with a scale for each entry of the first axis. The step is then ``step``, or 1 / 65534 of the entry's range
    where that is larger.

    Parameters
    ----------
    values
        The array; NaN where there is no value.
    step
        Step of large arrays, in the unit of the values.

    Returns
    -------
    dict
        Plain values, see arrays.js.
    """
    array = np.asarray(values)
    if array.dtype == np.uint8 or array.dtype == np.int16:
        return _stored(array, {np.dtype(np.uint8): "u1", np.dtype(np.int16): "i2"}[array.dtype])
    array = array.astype(np.float32)
    if array.size <= _MAX_EXACT_NUMBERS:
        return _stored(array, "f4")
    flat = array.reshape(len(array), -1).astype(np.float64)
    finite = np.isfinite(flat)
    low = np.where(finite, flat, np.inf).min(axis=1)
    high = np.where(finite, flat, -np.inf).max(axis=1)
    low, high = np.where(finite.any(axis=1), low, 0.0), np.where(finite.any(axis=1), high, 0.0)
    step_each = np.maximum((high - low) / 65534, max(step, 1e-30))
    steps = np.round((np.where(finite, flat, low[:, None]) - low[:, None]) / step_each[:, None])
    stored = np.where(finite, steps, 65535).astype(np.uint16).reshape(array.shape)
    return {**_stored(stored, "u2"), "scale": step_each.tolist(), "offset": low.tolist()}


def _stored(array: NDArray, kind: str) -> dict[str, Any]:
    size = array.dtype.itemsize
    little = np.ascontiguousarray(array.astype(array.dtype.newbyteorder("<")))
    # bytes of the same significance side by side deflate better
    planes = little.view(np.uint8).reshape(-1, size).T.tobytes()
    return {
        "type": kind,
        "shape": list(array.shape),
        "deflated": True,
        "data": base64.b64encode(zlib.compress(planes, 9)).decode("ascii"),
    }


def _block(c: Comparison) -> int:
    """Side of the blocks that are shown as one pixel, px; 1 for pictures that are not too large."""
    return int(np.ceil(np.sqrt(c.maps["measured"].size / _MAX_NUMBERS)))


def _means(values: ArrayLike, block: int) -> NDArray[np.float64]:
    """Means (..., y, x) over blocks; incomplete blocks are left out."""
    array = np.asarray(values, float)
    if block == 1:
        return array
    height, width = array.shape[-2] // block, array.shape[-1] // block
    cut = array[..., : height * block, : width * block]
    return cut.reshape(*array.shape[:-2], height, block, width, block).mean(axis=(-3, -1))


def _signals(c: Comparison, order: NDArray[np.int64], names: Sequence[str]) -> dict[str, Any]:
    """Maps of a comparison by name, encoded."""
    block, median = _block(c), float(np.nanmedian(c.maps["sigma"].values))
    signals = {}
    for name in names:
        values = c.maps[name].values[order]
        if name == "sigma":
            signals[name] = encoded(np.sqrt(_means(values**2, block)) / block, median * _SIGMA_STEP / block)
        else:
            signals[name] = encoded(_means(values, block), median * _SIGNAL_STEP / block)
    return signals


def flip_data(c: Comparison, rendered: ArrayLike | None = None) -> dict[str, Any] | None:
    """FLIP of a comparison's pictures at the size in which they are shown.

    Parameters
    ----------
    c
        The comparison.
    rendered
        (band, y, x) another rendering, DN; None for the comparison's.

    Returns
    -------
    dict | None
        Encoded (y, x) map; None without the evaluator.
    """
    c = _of_cells(c if rendered is None else replace(c, maps=c.maps.assign(rendered=(("band", "y", "x"), rendered))))
    block = _block(c)
    left_out = np.any(_any(c.maps["mask"].values.astype(np.uint8), block), axis=0, keepdims=True)

    def xyz(name: str) -> NDArray[np.float64]:
        signals = np.where(left_out, np.nan, _means(c.maps[name].values, block))
        return np.moveaxis(signals, 0, -1) @ c.xyz_per_dn.T

    try:
        return encoded(flip_map(xyz("measured"), xyz("rendered"), c.white), _LIGHT_STEP)
    except InputError:
        return None


def _every(values: NDArray, block: int) -> NDArray[np.int16]:
    """Labels (y, x) at the middle of every block."""
    height, width = (block * (n // block) for n in values.shape)
    return values[block // 2 : height : block, block // 2 : width : block].astype(np.int16)


def _any(flags: NDArray[np.uint8], block: int) -> NDArray[np.uint8]:
    """Flags (band, y, x) that any pixel of a block has."""
    bands, height, width = flags.shape
    cut = flags[:, : height // block * block, : width // block * block]
    parts = cut.reshape(bands, height // block, block, width // block, block)
    return np.bitwise_or.reduce(np.bitwise_or.reduce(parts, axis=-1), axis=2)


def _order(c: Comparison, centres_nm: Sequence[float] | None) -> NDArray[np.int64]:
    return np.arange(len(c.bands)) if centres_nm is None else np.argsort(centres_nm, kind="stable")


def _of_cells(c: Comparison) -> Comparison:
    """Signals and sigmas of whole cells in all their pixels; unchanged without a mosaic.

    The viewer computes colours from all bands of a pixel. A pixel is masked by the flags of its channel, and as one of
    other channels where its cell lacks a band.
    """
    if c.cell is None:
        return c
    maps = c.maps
    used = maps["mask"].values == 0
    variance = maps["sigma"].values ** 2
    cells = {name: cell_means(maps[name].values, variance, used, c.cell) for name in ("measured", "rendered")}
    mask = maps["mask"].values.astype(np.uint8)
    of_channel = np.bitwise_or.reduce(np.where(mask & Mask.OTHER_CHANNEL, np.uint8(0), mask), axis=0)
    lacking = ~cells["measured"].complete & (of_channel == 0)
    flags = np.where(lacking, np.uint8(Mask.OTHER_CHANNEL), of_channel)
    dims = ("band", "y", "x")
    changed = {name: (dims, means.signal) for name, means in cells.items()}
    changed["sigma"] = (dims, np.sqrt(cells["measured"].variance))
    changed["mask"] = (dims, np.broadcast_to(flags, used.shape))
    return replace(c, maps=maps.assign(changed), cell=None)


def picture_data(c: Comparison, centres_nm: Sequence[float] | None = None) -> dict[str, Any]:
    """Data of a comparison alone, its bands in the order of their wavelengths.

    A picture of more than two million numbers is reduced to means of square blocks, and the viewer says so.

    Parameters
    ----------
    c
        The comparison.
    centres_nm
        (band,) centres of the bands in the comparison's order, nm; None if not known.

    Returns
    -------
    dict
        Plain values, documented in viewer.js.
    """
    c = _of_cells(c)
    order = _order(c, centres_nm)
    nm: list[float | None] = [None] * len(order) if centres_nm is None else [float(centres_nm[i]) for i in order]
    maps, block = c.maps, _block(c)
    mask = _any(maps["mask"].values[order].astype(np.uint8), block)
    lacks_a_channel = np.any(maps["mask"].values & Mask.OTHER_CHANNEL)
    reasons = [r for r in Mask if r.name and (r.is_defect or lacks_a_channel)]

    def stops(name: str) -> list[str]:
        return [matplotlib.colors.to_hex(v) for v in matplotlib.colormaps[name](np.linspace(0, 1, _NUM_STOPS))]

    return {
        "width": maps.sizes["x"] // block,
        "height": maps.sizes["y"] // block,
        "block": block,
        "bands": [{"id": c.bands[i], "nm": centre} for i, centre in zip(order, nm, strict=True)],
        **_signals(c, order, ("measured", "rendered", "sigma")),
        "mask": encoded(mask),
        "reasons": [{"bit": r.value, "name": (r.name or "").lower()} for r in reasons],
        "surface": encoded(_every(maps["surface"].values, block)),
        "surfaces": list(c.by_surface),
        "xyz_per_dn": c.xyz_per_dn[:, order].tolist(),
        "xyz_unit": "cd m⁻²",
        "white": {"x": c.white.x, "y": c.white.y, "luminance": c.white.luminance},
        "srgb": srgb_matrix(c.white).tolist(),
        "colour_differences": [
            {
                "id": d.id,
                "label": d.label,
                "title": d.title,
                "unit": "" if d.unit == "1" else d.unit,
                "script": d.script,
            }
            for d in (COLOUR_DIFFERENCES[name] for name in c.colour)
            if d.script is not None
        ],
        "flip": flip_data(c),
        "flip_lacking": FLIP_LACKING,
        "colours": {"diverging": stops("RdBu_r"), "sequential": stops("cividis")},
        "light": None,
        "spectrum": None,
        "filters": None,
        "maps": [],
    }


def viewer_data(validation: Validation, maps: Sequence[Mapping[str, Any]] = ()) -> dict[str, Any]:
    """Data of a validation: comparison, rendered spectra, light by number of reflections.

    Parameters
    ----------
    validation
        The validation.
    maps
        Further layers {id, name, unit, perBand, values, red}. The values are (band, y, x) in the capture's order of
        bands where perBand is true, otherwise (y, x). ``red``, optional, says what a positive value means.

    Returns
    -------
    dict
        Plain values, documented in viewer.js.
    """
    c = validation.comparison
    centres = band_centres(validation.prepared.responses)
    order = _order(c, centres)
    data = picture_data(c, centres)
    image = validation.image
    block = data["block"]
    data["surface"] = encoded(_every(image.surface, block))
    wavelength, basis, each = pixel_spectra(image, validation.fit.lamp_scale)
    coefficients = _means(each, block)
    step = float(np.abs(coefficients).max()) * _LIGHT_STEP
    data["spectrum"] = {
        "wavelength_nm": wavelength.tolist(),
        "rank": len(basis),
        "basis": encoded(basis),
        "coefficients": encoded(coefficients, step),
        "unit": "W m⁻² sr⁻¹ nm⁻¹",
    }
    wavelength, curves = filter_curves(validation.prepared.responses)
    data["filters"] = {"wavelength_nm": wavelength.tolist(), "curves": encoded(curves[order])}
    if (parts := light_parts(validation)) is not None:
        shares = _means(np.stack(list(parts.values())), block)
        data["light"] = {"names": list(parts), "share": encoded(shares, _LIGHT_STEP)}
    for layer in maps:
        values = np.asarray(layer["values"])
        ordered = values[order] if layer.get("perBand") else values
        data["maps"].append({**layer, "values": encoded(_means(ordered, block), _SIGNAL_STEP)})
    return data
