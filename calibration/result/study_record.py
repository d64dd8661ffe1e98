"""The sensor and colour studies as plain values for calibration.json."""

from __future__ import annotations

from typing import Any

from ..colour import ColourError, ColourStudy, FilterWeights
from ..detector import SensorStudy
from ..radiometry import Uncertainty

__all__ = ["colour_record", "sensor_record", "uncertainty_record", "weights_record"]


def weights_record(weights: FilterWeights) -> dict[str, Any]:
    """Filter weights by axis, the residual of the curves, the noise gain.

    Parameters
    ----------
    weights
        Filter weights.

    Returns
    -------
    dict[str, Any]
        Values for JSON.
    """
    return {
        "method": weights.method,
        "bands": list(weights.bands),
        **{name: row.tolist() for name, row in zip("XYZ", weights.weights, strict=True)},
        "residual_rms": dict(zip("XYZ", weights.residual_rms.tolist(), strict=True)),
        "noise_gain": dict(zip("XYZ", weights.noise_gain.tolist(), strict=True)),
        "relative_noise": weights.relative_noise.tolist(),
    }


def _error(error: ColourError) -> dict[str, Any]:
    """Colour errors of filter weights as values for JSON."""
    return {
        "relative_rms": dict(zip("XYZ", error.rms.tolist(), strict=True)),
        "relative_largest": dict(zip("XYZ", error.largest.tolist(), strict=True)),
        "delta_e_ab": {"mean": float(error.delta_e_ab.mean()), "max": float(error.delta_e_ab.max())},
        "delta_e_2000": {"mean": float(error.delta_e_2000.mean()), "max": float(error.delta_e_2000.max())},
        "worst": error.worst,
    }


def colour_record(study: ColourStudy) -> dict[str, Any]:
    """All methods with their errors, the best subsets of the bands, and the method in use.

    Parameters
    ----------
    study
        Colour study.

    Returns
    -------
    dict[str, Any]
        Values for JSON.
    """
    return {
        "used": study.recommended,
        "spectra": study.spectra,
        "trained_on": study.ensemble,
        "methods": {
            method: weights_record(weights) | {"error": _error(study.errors[method])}
            for method, weights in study.weights.items()
        },
        "fewer_bands": [
            {"bands": list(choice.bands), "training_rms": choice.training_rms, "error": _error(choice.error)}
            for choice in study.choices
        ],
    }


def uncertainty_record(uncertainty: Uncertainty) -> dict[str, Any]:
    """Band and common components; the pixel component is in the maps.

    Parameters
    ----------
    uncertainty
        Uncertainty of the band signals.

    Returns
    -------
    dict[str, Any]
        Values for JSON.
    """
    return {
        "band": dict(zip(uncertainty.bands, uncertainty.band.tolist(), strict=True)),
        "band_covariance": uncertainty.band_covariance.tolist(),
        "band_degrees_of_freedom": uncertainty.band_degrees,
        "common": uncertainty.common,
    }


def _pair(value: float, sigma: float) -> dict[str, float]:
    return {"value": value, "sigma": sigma}


def sensor_record(study: SensorStudy) -> dict[str, Any]:
    """Photon transfer, dark fit, response series, calibration curve; null where there is none.

    Parameters
    ----------
    study
        Sensor study.

    Returns
    -------
    dict[str, Any]
        Values for JSON.
    """
    transfer, dark, curve = study.transfer, study.dark_fit, study.curve
    return {
        "photon_transfer": None
        if transfer is None
        else {
            "K_dn_per_e": _pair(transfer.gain_dn_per_e, transfer.gain_sigma),
            "dark_noise_e": _pair(transfer.dark_noise_e, transfer.dark_noise_sigma),
            "dsnu_e": _pair(transfer.dsnu_e, transfer.dsnu_sigma),
            "prnu": _pair(transfer.prnu, transfer.prnu_sigma),
            "saturation_e": transfer.saturation_e,
            "converter_limit_e": transfer.converter_limit_e,
        },
        "dark_fit": None
        if dark is None
        else {
            "bias_dn": _pair(dark.bias_dn, dark.bias_sigma),
            "rate_dn_s": _pair(dark.rate_dn_s, dark.rate_sigma),
            "degrees_of_freedom": dark.degrees,
            "residual_dn": dark.residual_dn.tolist(),
            "rms_dn": dark.rms_dn,
            "monotonic": dark.monotonic,
            "verdict": dark.verdict,
        },
        "response": [
            {
                "setting": s.key,
                "band": s.band,
                "source": s.source,
                "values": s.fit.setting.tolist(),
                "signal_dn": s.fit.signal.tolist(),
                "residual": s.fit.residual.tolist(),
                "slope": _pair(s.fit.slope, s.fit.slope_sigma),
                "chi2": s.fit.chi2,
                "probability": s.fit.probability,
                "departure": None
                if s.fit.departure is None
                else {
                    "kind": s.fit.departure.kind,
                    **_pair(s.fit.departure.size, s.fit.departure.sigma),
                    "largest_effect": s.fit.departure.largest,
                },
                "verdict": s.fit.verdict,
            }
            for s in study.responses
        ],
        "calibration_curve": None
        if curve is None
        else {
            "count": curve.knot_count.tolist(),
            "linear": curve.knot_value.tolist(),
            "residual": curve.statistics,
            "residual_rms_of_a_straight_line": curve.line_rms,
        },
    }
