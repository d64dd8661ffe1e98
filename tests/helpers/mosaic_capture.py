"""Captures of a rendered image behind a mosaic: one frame of all channels, which stands in a band for each channel."""

import tomllib

import numpy as np
import tomli_w
from cboxlab.calibration.capture import channel_mask
from cboxlab.calibration.instrument import lens_constant, response_factors, rest_curve
from cboxlab.rendering.chain import band_signals, field_shares, over_field, scene_light, uniform_light
from cboxlab.rendering.synthetic import CaptureSettings, sphere_spectrum, write_photographs
from cboxlab.scenes.spectra import Spectrum, read_spectra
from cboxlab.scenes.wavelength_grid import FILTER_GRID, WAVELENGTH_NM

__all__ = ["write_mosaic_capture"]

#: Peak and width of each channel's dye, nm.
DYES = {"R": (600.0, 40.0), "G": (540.0, 45.0), "B": (460.0, 35.0)}

FILTER_NM = np.arange(380.0, 721.0, 5.0)


def dye(channel):
    """Transmittance of a channel's dye on WAVELENGTH_NM."""
    peak, width = DYES[channel]
    return 0.9 * np.exp(-0.5 * ((WAVELENGTH_NM - peak) / width) ** 2)


def write_mosaic_capture(folder, pattern, image, scene, camera, seed, **changes):
    """Photograph an image behind a mosaic by the sensor equation, with noise, flats, references, darks and a survey.

    The laboratory is the usual one (``write_photographs``) with a single band. Its frames then stand in a band for each
    channel, in capture.toml.
    """
    settings = CaptureSettings(filters={"open": Spectrum(FILTER_NM, np.ones(FILTER_NM.size), "zero")}, **changes)
    grid, bands = FILTER_GRID, tuple(DYES)
    probe = folder.parent / f"{folder.name}-curves"
    ones = np.ones((1, *image.sees_lamp.shape))
    write_photographs(
        probe, ones, ones, image.sees_lamp, camera=camera, scene=scene, settings=settings, seed=seed
    )  # for the curves of its sensor
    curves = read_spectra(probe / "spectra" / "camera.csv", "zero")
    efficiency = {
        channel: Spectrum(WAVELENGTH_NM, curves["quantum_efficiency"].at(WAVELENGTH_NM) * dye(channel), "zero")
        for channel in bands
    }
    constant = lens_constant(
        settings.focal_length_mm, settings.film_width_mm * 1e3 / camera.width_px, settings.gain_e_per_dn
    )
    factors = response_factors(
        dict.fromkeys(bands, settings.filters["open"]),
        [rest_curve(efficiency[channel], curves["lens"], grid) for channel in bands],
        [constant / (settings.f_number * settings.image_distance_mm) ** 2] * len(bands),
        grid,
    )
    response = over_field(factors, camera)
    signals = scene_light(image, response, camera).signal
    even = uniform_light(sphere_spectrum(settings.sphere_brightness).values)
    field = np.broadcast_to(band_signals(even, response, field_shares(response, camera)), signals.shape)
    masks = [channel_mask(pattern, image.sees_lamp.shape, channel) for channel in bands]
    mosaic = [np.sum(np.where(masks, picture, 0.0), axis=0)[None] for picture in (signals, field)]
    write_photographs(folder, *mosaic, image.sees_lamp, camera=camera, scene=scene, settings=settings, seed=seed)
    table = np.column_stack([WAVELENGTH_NM, *(efficiency[channel].values for channel in bands)])
    header = ",".join(["wavelength_nm", *(channel.lower() for channel in bands)])
    np.savetxt(folder / "spectra" / "channels.csv", table, "%.8g", ",", header=header, comments="")
    path = folder / "capture.toml"
    manifest = tomllib.loads(path.read_text(encoding="utf-8"))
    manifest["mosaic"] = {"pattern": pattern}
    manifest["camera"]["quantum_efficiency"] = {c: f"spectra/channels.csv:{c.lower()}" for c in bands}
    (band,) = manifest["band"]
    manifest["band"] = [{**band, "id": channel.lower(), "channel": channel} for channel in bands]
    for kind in ("flat", "reference"):
        (one,) = manifest[kind]
        manifest[kind] = [{**one, "band": channel.lower()} for channel in bands]
    path.write_text(tomli_w.dumps(manifest), encoding="utf-8")
    return folder, constant
