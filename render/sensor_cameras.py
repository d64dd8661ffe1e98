"""Cameras as data: a TOML file and its CSV tables become a SensorCamera (see data/cameras/README.md)."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from cboxlab.calibration.sensor_equation import PLANCK_J_S, SPEED_OF_LIGHT_M_S
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.faults import combined, faults_of_validation, suggestion
from cboxlab.scenes.spectra import Spectrum, read_spectrum
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from .sensor import Detector, SensorCamera, channel_map

__all__ = ["load_camera", "packaged_cameras"]

PACKAGED = Path(__file__).parent / "data" / "cameras"

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _Detector(_Table):
    gain_e_per_dn: Positive
    bit_depth: Annotated[int, Field(ge=1, le=16)]
    full_well_e: Positive | None = None


class _Dark(_Table):
    exposure_s: Annotated[list[Positive], Field(min_length=1)]
    mean_dn: list[float]
    sigma_dn: list[NotNegative]


class _Nonlinearity(_Table):
    linear_dn: Annotated[list[float], Field(min_length=2)]
    recorded_dn: list[float]


class _Optics(_Table):
    pixel_pitch_um: Positive
    working_f_number: Positive


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


def packaged_cameras() -> list[str]:
    """Names of the cameras that come with the program."""
    return sorted(path.stem for path in PACKAGED.glob("*.toml"))


def load_camera(name_or_path: str | Path) -> SensorCamera:
    """A camera of the program's own by name ("dcs200", "pxl1300l"), or of a TOML file.

    Raises InputError naming file and key for an unknown name, faults of the file or of its tables.
    """
    known = packaged_cameras()
    path = PACKAGED / f"{name_or_path}.toml" if str(name_or_path) in known else Path(name_or_path)
    expected = "a camera file in TOML"
    try:
        content = tomllib.loads(path.read_bytes().decode("utf-8"))
    except FileNotFoundError:
        hint = suggestion(str(name_or_path), known) or f"cameras of the program's own: {', '.join(known)}"
        raise InputError(path, "no such file", expected, hint) from None
    except UnicodeDecodeError:
        raise InputError(path, "bytes that are no text", expected) from None
    except OSError as error:
        raise InputError(path, error.strerror or str(error), expected) from None
    except ValueError as error:
        raise InputError(path, str(error), expected) from None
    try:
        file = _CameraFile.model_validate(content)
    except ValidationError as error:
        raise combined(faults_of_validation(path, error, _CameraFile)) from None
    pattern = None if file.mosaic is None else tuple(file.mosaic.pattern)
    if pattern is not None:
        try:
            channel_map(pattern, tuple(file.channel), (1, 1))
        except InputError as fault:
            raise InputError(f"{path}: {fault.where}", fault.found, fault.expected, fault.hint) from None
    return SensorCamera(file.name, _channels(path, file), pattern, _detector(path, file), file.source)


def _detector(path: Path, file: _CameraFile) -> Detector:
    exposure, mean, sigma = _columns(
        path, "dark", file.dark.exposure_s, file.dark.mean_dn, file.dark.sigma_dn
    )
    linear = recorded = None
    if file.nonlinearity is not None:
        linear, recorded = _columns(
            path, "nonlinearity", file.nonlinearity.linear_dn, file.nonlinearity.recorded_dn
        )
        if np.any(np.diff(recorded) <= 0):
            where = f"{path}: nonlinearity.recorded_dn"
            raise InputError(where, "values that fall or stay", "ascending values")
    values = file.detector
    return Detector(
        values.gain_e_per_dn, values.bit_depth, exposure, mean, sigma, values.full_well_e, linear, recorded,
    )  # fmt: skip


def _columns(path: Path, table: str, *columns: list[float]) -> list[np.ndarray]:
    """Columns of equal length, the first ascending."""
    lengths = [len(column) for column in columns]
    if len(set(lengths)) > 1:
        raise InputError(f"{path}: {table}", f"columns of {lengths} values", "columns of equal length")
    if np.any(np.diff(columns[0]) <= 0):
        raise InputError(f"{path}: {table}", "a first column that does not ascend", "ascending values")
    return [np.array(column, float) for column in columns]


def _channels(path: Path, file: _CameraFile) -> dict[str, Spectrum]:
    """Responsivities, e- s^-1 per (W m^-2 sr^-1): (pi / 4) pixel area / N^2 times quanta per joule, QE."""
    kind, peak = file.sensitivity.kind, file.sensitivity.peak_quantum_efficiency
    if (kind == "relative_energy") != (peak is not None):
        raise InputError(
            f"{path}: sensitivity.peak_quantum_efficiency",
            "nothing" if peak is None else f"{peak:g} beside kind = '{kind}'",
            "a value for relative_energy, none for quantum_efficiency",
        )
    efficiencies = {}
    for name, reference in file.channel.items():
        curves = [read_spectrum(path.parent, text, "zero") for text in (reference, *file.sensitivity.common)]
        low = max(curve.wavelength_nm[0] for curve in curves)
        high = min(curve.wavelength_nm[-1] for curve in curves)
        if any(np.any(curve.values < 0) for curve in curves) or low >= high:
            found = "a negative value" if low < high else "tables without a common range of wavelengths"
            raise InputError(f"{path}: channel.{name}", found, "curves of 0 or more with a common range")
        grid = np.arange(low, high + 0.5)
        product = np.prod([curve.at(grid) for curve in curves], axis=0)
        efficiencies[name] = (grid, product / grid if kind == "relative_energy" else product)
    highest = max(float(values.max()) for _, values in efficiencies.values())
    if highest <= 0:
        raise InputError(f"{path}: channel", "curves of zeros", "a camera that sees light")
    scale = 1.0 if peak is None else peak / highest
    solid = np.pi / 4 * (file.optics.pixel_pitch_um * 1e-6) ** 2 / file.optics.working_f_number**2
    quanta = 1e-9 / (PLANCK_J_S * SPEED_OF_LIGHT_M_S)
    return {
        name: Spectrum(grid, scale * solid * quanta * grid * values, "zero")
        for name, (grid, values) in efficiencies.items()
    }
