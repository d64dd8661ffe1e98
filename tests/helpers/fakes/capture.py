"""A capture of known truth, written by the capture format's own words: input for tests of the calibration.

An independent forward model: it shares no code with the calibration beyond the spectra's interpolation.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tifffile

GAIN, READ_NOISE, BIAS, DEPTH = 12.0, 10.0, 100.0, 12
F_NUMBER, DISTANCE_MM, FOCAL_MM, PITCH_UM = 8.0, 36.6, 35.0, 97.65625
CONSTANT = np.pi / 4 * FOCAL_MM**2 * (PITCH_UM * 1e-6) ** 2 / GAIN
CENTRES_NM = (400, 450, 500, 550, 600, 650, 700)
GRID = np.arange(400.0, 701.0)


def response(centre_nm: float) -> np.ndarray:
    """F Q T_lens T_i of the fake camera on GRID."""
    quanta = GRID * 1e-9 / (6.626e-34 * 2.998e8)
    return quanta * efficiency() * 0.8 * bell(centre_nm)


def efficiency() -> np.ndarray:
    return 0.2 + 0.3 * np.sin((GRID - 380) / 340 * np.pi)


def bell(centre_nm: float) -> np.ndarray:
    return 0.7 * np.exp(-0.5 * ((GRID - centre_nm) / 20) ** 2)


def sphere() -> np.ndarray:
    """Radiance of the reference on GRID."""
    return 1e-4 * (0.5 + (GRID - 400) / 300)


@dataclass
class FakeCapture:
    """Truth and files. ``light`` (y, x) times ``spectrum`` is the radiance of the scene."""

    folder: Path
    seed: int = 0
    height: int = 40
    width: int = 56
    centres: tuple[int, ...] = CENTRES_NM
    repeats: int = 2
    hot: dict[tuple[int, int], float] = field(default_factory=dict)
    dead: tuple[tuple[int, int], ...] = ()
    saturated: tuple[tuple[int, int], ...] = ()
    gains: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        shape = (self.height, self.width)
        v, u = np.indices(shape)
        radius = ((u - self.width / 2) ** 2 + (v - self.height / 2) ** 2) / (self.width / 2) ** 2
        flat = (1 - 0.2 * radius) * (1 + 0.01 * self.rng.standard_normal(shape))
        for pixel in self.dead:
            flat[pixel] *= 0.4
        self.flat = flat / flat.mean()
        self.rate = np.full(shape, 1.5)
        for pixel, rate in self.hot.items():
            self.rate[pixel] = rate
        self.bias = BIAS + 0.5 * self.rng.standard_normal(shape)
        self.light = 0.3 + 0.7 * u / self.width
        self.spectrum = 0.9e-4 * (1.2 - (GRID - 400) / 600)
        # Exposures that bring the flat of the sphere to 1800 DN, as an operator would choose.
        weights = np.ones(GRID.size)
        weights[[0, -1]] = 0.5
        self.signal_per_s = {
            f"f{c}": CONSTANT / (F_NUMBER * DISTANCE_MM) ** 2 * float(np.sum(weights * response(c) * sphere()))
            for c in self.centres
        }
        self.scene_per_s = {
            f"f{c}": CONSTANT / (F_NUMBER * DISTANCE_MM) ** 2 * float(np.sum(weights * response(c) * self.spectrum))
            for c in self.centres
        }
        self.exposure = {b: float(f"{1500 / self.signal_per_s[b]:.3g}") for b in self.signal_per_s}

    @property
    def bands(self) -> tuple[str, ...]:
        return tuple(self.exposure)

    def expected(self, band: str) -> np.ndarray:
        """(y, x) the corrected signal without noise, DN."""
        return self.light * self.scene_per_s[band] * self.exposure[band]

    def counts(self, signal: np.ndarray, exposure_s: float) -> np.ndarray:
        """One frame of a signal (y, x) in DN above dark, for a flat of 1 already multiplied in."""
        electrons = self.rng.poisson(GAIN * (signal + self.rate * exposure_s))
        counted = electrons + READ_NOISE * self.rng.standard_normal(signal.shape)
        return np.clip(np.rint(counted / GAIN + self.bias), 0, 2**DEPTH - 1).astype(np.uint16)

    def _frames(self, stem: str, signal: np.ndarray, exposure_s: float, repeats: int) -> str:
        names = [f"frames/{stem}-{index}.tif" for index in range(repeats)]
        for name in names:
            tifffile.imwrite(self.folder / name, self.counts(signal, exposure_s))
        return "frames = [" + ", ".join(f'"{name}"' for name in names) + "]\n"

    def write(self, darks: bool = True, flats: bool = True, references: bool = True, extra: str = "") -> Path:
        """The folder, with capture.toml."""
        for name in ("frames", "spectra"):
            (self.folder / name).mkdir(parents=True, exist_ok=True)
        columns = {"quantum_efficiency": efficiency(), "lens": np.full(GRID.size, 0.8), "sphere": sphere()}
        columns |= {f"f{c}": bell(c) for c in self.centres}
        table = np.column_stack([GRID, *columns.values()])
        header = ",".join(["wavelength_nm", *columns])
        path = self.folder / "spectra" / "all.csv"
        np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.10g")
        optics = f"f_number = {F_NUMBER}\nimage_distance_mm = {DISTANCE_MM}\n"
        text = (
            'format = "capture/1"\nname = "fake"\n[camera]\n'
            f"width_px = {self.width}\nheight_px = {self.height}\nbit_depth = {DEPTH}\n"
            f"pixel_pitch_um = {PITCH_UM}\ngain_e_per_dn = {GAIN}\nread_noise_e = {READ_NOISE}\n"
            'quantum_efficiency = "spectra/all.csv:quantum_efficiency"\n'
            f'[lens]\nfocal_length_mm = {FOCAL_MM}\ntransmittance = "spectra/all.csv:lens"\n'
        )
        for band, seconds in self.exposure.items():
            signal = self.expected(band) * self.flat * self.gains.get(band, 1.0)
            for pixel in self.saturated:
                signal[pixel] = 5000.0
            text += f'[[band]]\nid = "{band}"\nexposure_s = {seconds}\n{optics}'
            text += f'transmittance = "spectra/all.csv:{band}"\n'
            text += self._frames(band, signal, seconds, self.repeats)
        for seconds in sorted(set(self.exposure.values())) if darks else ():
            text += f"[[dark]]\nexposure_s = {seconds}\n"
            text += self._frames(f"dark-{seconds}", np.zeros(self.flat.shape), seconds, self.repeats)
        for band, seconds in self.exposure.items() if flats else ():
            text += f'[[flat]]\nband = "{band}"\nexposure_s = {seconds}\n{optics}'
            text += self._frames(f"flat-{band}", 2000.0 * self.flat, seconds, self.repeats)
        for band, seconds in self.exposure.items() if references else ():
            signal = self.signal_per_s[band] * seconds * self.flat * self.gains.get(band, 1.0)
            text += f'[[reference]]\nband = "{band}"\nexposure_s = {seconds}\n{optics}'
            text += 'radiance = "spectra/all.csv:sphere"\n' + self._frames(f"sphere-{band}", signal, seconds, 1)
        (self.folder / "capture.toml").write_text(text + extra)
        return self.folder
