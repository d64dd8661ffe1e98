"""The forward chain: its stages, and the way from spectral light to expected counts.

The prediction of a capture and the synthetic capture both go this way: band responses, field angles, optics, counts.
The sensor simulator (``render.sensor``) has the lens constant and the quanta per joule in common with it, but not the
integral, the optics and the counts. The capture format fixes the integral here: the trapezoidal rule over 1 nm. A cube
has wavelengths of any spacing, between which a channel's fine structure counts (``integration_weights``). The
simulator's blur differs from wavelength to wavelength and so precedes the integral. Its electrons are drawn, cut
off and spilled pixel by pixel before they are counted; here the expected signals of complete bands are needed, in which
effects act. Where both apply they agree: a simulated capture holds its cube's light by the capture format's equation.
"""

from .band_curves import BandCurves, field_shares, field_sine_squared, over_field
from .bands import render_bands
from .counts import Counts, with_charge_moved
from .expected import expected_counts, expected_signal
from .interleaving import Interleaving, UnseenChannel
from .light import Light, with_scene_behind
from .projection import Projection, band_signals, scene_light, uniform_light
from .sensing import MergedExposure, Sensing
from .settings import RenderSettings
from .stages import PHOTOGRAPHED, STAGE_TITLES, STAGES, ActsAtStage, Stage, after_stage, stages_between

__all__ = [
    "PHOTOGRAPHED",
    "STAGES",
    "STAGE_TITLES",
    "ActsAtStage",
    "BandCurves",
    "Counts",
    "Interleaving",
    "Light",
    "MergedExposure",
    "Projection",
    "RenderSettings",
    "Sensing",
    "Stage",
    "UnseenChannel",
    "after_stage",
    "band_signals",
    "expected_counts",
    "expected_signal",
    "field_shares",
    "field_sine_squared",
    "over_field",
    "render_bands",
    "scene_light",
    "stages_between",
    "uniform_light",
    "with_charge_moved",
    "with_scene_behind",
]
