"""Sensor cameras in TOML files with CSV tables (see data/README.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from cboxlab.calibration.instrument import lens_constant, quanta_per_joule
from cboxlab.scenes.spectra import Spectrum, read_spectrum
from cboxlab.utils.arguments import required_path
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import suggestion, validated
from cboxlab.utils.input_files import read_toml
from pydantic import BaseModel, ConfigDict, Field

from .detector import Detector, SensorCamera, channel_map
from .optics import Blur, Vignetting

__all__ = ["load_camera", "packaged_cameras"]

#: Folder of the packaged cameras and their tables.
PACKAGED = Path(__file__).parent / "data"

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class _Detector(_Table):
    gain_e_per_dn: Positive
    bit_depth: Annotated[int, Field(ge=1, le=16)]
    full_well_e: Positive | None = None
    overflow: Literal["drain", "column"] = "drain"


class _Dark(_Table):
    exposure_s: Annotated[list[Positive], Field(min_length=1)]
    mean_dn: list[float]
    sigma_dn: list[NotNegative]


class _FixedPattern(_Table):
    sensitivity_spread: NotNegative = 0.0
    offset_spread_dn: NotNegative = 0.0
    seed: Annotated[int, Field(ge=0)] = 0


class _Leakage(_Table):
    row: Annotated[float, Field(ge=0, le=0.25)] = 0.0
    column: Annotated[float, Field(ge=0, le=0.25)] = 0.0


class _Nonlinearity(_Table):
    linear_dn: Annotated[list[float], Field(min_length=2)] | None = None
    recorded_dn: list[float] | None = None
    square_root_from_dn: Positive | None = None


class _Optics(_Table):
    pixel_pitch_um: Positive
    working_f_number: Positive


class _Vignetting(_Table):
    field: Annotated[list[Annotated[float, Field(ge=0, le=1)]], Field(min_length=2)]
    illumination: list[Annotated[float, Field(ge=0, le=1)]]


class _Blur(_Table):
    wavelength_nm: Annotated[list[Positive], Field(min_length=1)]
    centre_px: list[Annotated[float, Field(ge=0, le=20)]]
    corner_px: list[Annotated[float, Field(ge=0, le=20)]]


class _Sensitivity(_Table):
    kind: Literal["quantum_efficiency", "relative_energy"]
    peak_quantum_efficiency: Annotated[float, Field(gt=0, le=1)] | None = None
    common: list[str] = []


class _Mosaic(_Table):
    pattern: Annotated[list[Annotated[str, Field(min_length=1)]], Field(min_length=1)]


class _CameraFile(_Table):
    name: str
    source: str
    detector: _Detector
    dark: _Dark
    optics: _Optics
    sensitivity: _Sensitivity
    channel: Annotated[dict[str, str], Field(min_length=1)]
    mosaic: _Mosaic | None = None
    nonlinearity: _Nonlinearity | None = None
    fixed_pattern: _FixedPattern = _FixedPattern()
    leakage: _Leakage = _Leakage()
    vignetting: _Vignetting | None = None
    blur: _Blur | None = None


def packaged_cameras() -> list[str]:
    """Names of the packaged cameras.

    Returns
    -------
    list of str
        Names, sorted.
    """
    return sorted(path.stem for path in PACKAGED.glob("*.toml"))


def load_camera(name_or_path: str | Path) -> SensorCamera:
    """Camera of a name or a file.

    Parameters
    ----------
    name_or_path
        Name of a packaged camera ("dcs200", "pxl1300l"), or path of a TOML file.

    Returns
    -------
    SensorCamera
        The camera.

    Raises
    ------
    InputError
        If the name is unknown, or the file or its tables have faults, with file and key.
    """
    names = packaged_cameras()
    file_path = required_path("camera", name_or_path, "a camera, its name or its file")
    path = PACKAGED / f"{name_or_path}.toml" if str(name_or_path) in names else file_path
    hint = suggestion(str(name_or_path), names) or f"packaged cameras: {', '.join(names)}"
    content = read_toml(path, "a camera file in TOML", hint)
    file = validated(path, content, _CameraFile)
    pattern = None if file.mosaic is None else tuple(file.mosaic.pattern)
    if pattern is not None:
        try:
            channel_map(pattern, tuple(file.channel), (1, 1))
        except InputError as fault:
            raise InputError(f"{path}: {fault.where}", fault.found, fault.expected, fault.hint) from None
    vignetting = blur = None
    if file.vignetting is not None:
        rows = _columns(path, "vignetting", file.vignetting.field, file.vignetting.illumination)
        vignetting = Vignetting(*rows)
    if file.blur is not None:
        lens = file.blur
        blur = Blur(*_columns(path, "blur", lens.wavelength_nm, lens.centre_px, lens.corner_px))
    return SensorCamera(
        file.name,
        _channels(path, file),
        pattern,
        _detector(path, file),
        file.source,
        file.optics.working_f_number,
        file.optics.pixel_pitch_um,
        blur,
        vignetting,
    )


def _detector(path: Path, file: _CameraFile) -> Detector:
    """Detector of a camera file. Raises InputError where blooming lacks a full well."""
    exposure, mean, sigma = _columns(path, "dark", file.dark.exposure_s, file.dark.mean_dn, file.dark.sigma_dn)
    values, pattern = file.detector, file.fixed_pattern
    if values.overflow == "column" and values.full_well_e is None:
        raise InputError(f"{path}: detector.full_well_e", "nothing", "a value, since overflow = 'column'")
    linear, recorded = _nonlinearity(path, file)
    return Detector(
        values.gain_e_per_dn,
        values.bit_depth,
        exposure,
        mean,
        sigma,
        values.full_well_e,
        values.overflow == "column",
        (file.leakage.row, file.leakage.column),
        pattern.sensitivity_spread,
        pattern.offset_spread_dn,
        pattern.seed,
        linear,
        recorded,
    )


def _nonlinearity(path: Path, file: _CameraFile) -> tuple[np.ndarray | None, np.ndarray | None]:
    """F as a table: linear and recorded DN (k,); (None, None) for the identity."""
    table = file.nonlinearity
    if table is None:
        return None, None
    where = f"{path}: nonlinearity"
    if table.square_root_from_dn is not None:
        if table.linear_dn is not None or table.recorded_dn is not None:
            raise InputError(where, "a table and square_root_from_dn", "one of the two")
        recorded = np.arange(2.0**file.detector.bit_depth)
        return table.square_root_from_dn * (recorded / recorded[-1]) ** 2, recorded
    if table.linear_dn is None or table.recorded_dn is None:
        raise InputError(where, "an incomplete table", "linear_dn and recorded_dn, or square_root_from_dn")
    linear, recorded = _columns(path, "nonlinearity", table.linear_dn, table.recorded_dn)
    if np.any(np.diff(recorded) <= 0):
        raise InputError(f"{where}.recorded_dn", "values that do not ascend", "ascending values")
    return linear, recorded


def _columns(path: Path, table: str, *columns: list[float]) -> list[np.ndarray]:
    """Columns of equal length, the first ascending."""
    lengths = [len(column) for column in columns]
    if len(set(lengths)) > 1:
        raise InputError(f"{path}: {table}", f"columns of {lengths} values", "columns of equal length")
    if np.any(np.diff(columns[0]) <= 0):
        raise InputError(f"{path}: {table}", "a first column that does not ascend", "ascending values")
    return [np.array(column, float) for column in columns]


def _channels(path: Path, file: _CameraFile) -> dict[str, Spectrum]:
    """Responsivities by channel, e- s^-1 per (W m^-2 sr^-1).

    (pi / 4) pixel area / N^2 times quanta per joule times the quantum efficiency.
    """
    kind, peak = file.sensitivity.kind, file.sensitivity.peak_quantum_efficiency
    if (kind == "relative_energy") != (peak is not None):
        raise InputError(
            f"{path}: sensitivity.peak_quantum_efficiency",
            "nothing" if peak is None else f"{peak:g} with kind = '{kind}'",
            "a value for relative_energy, none for quantum_efficiency",
        )
    efficiencies = {}
    for name, reference in file.channel.items():
        curves = [read_spectrum(path.parent, text, "zero") for text in (reference, *file.sensitivity.common)]
        low = max(curve.wavelength_nm[0] for curve in curves)
        high = min(curve.wavelength_nm[-1] for curve in curves)
        if any(np.any(curve.values < 0) for curve in curves) or low >= high:
            fault = "a negative value" if low < high else "tables without a common range of wavelengths"
            raise InputError(f"{path}: channel.{name}", fault, "curves of 0 or more with a common range")
        grid = np.arange(low, high + 0.5)
        product = np.prod([curve.at(grid) for curve in curves], axis=0)
        efficiencies[name] = (grid, product / grid if kind == "relative_energy" else product)
    highest = max(float(values.max()) for _, values in efficiencies.values())
    if highest <= 0:
        raise InputError(f"{path}: channel", "curves that are 0 everywhere", "a value above 0")
    scale = 1.0 if peak is None else peak / highest
    # in electrons, and the working f-number stands for f-number, image distance and focal length
    collected = lens_constant(1.0, file.optics.pixel_pitch_um, 1.0) / file.optics.working_f_number**2
    return {
        name: Spectrum(grid, scale * collected * quanta_per_joule(grid) * values, "zero")
        for name, (grid, values) in efficiencies.items()
    }
