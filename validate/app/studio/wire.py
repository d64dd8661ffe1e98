"""Records for the page: the study in JSON, followed by pictures as 32-bit numbers."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from cboxlab.calibration.instrument import band_centres
from cboxlab.rendering.chain import STAGE_TITLES, STAGES
from cboxlab.rendering.effects import AppliedEffect, Effect, Parameter, catalogue, names_in
from numpy.typing import NDArray

from ...api import DiagnosisResult
from ...report import explained_share, finding_sentences, ranked_values
from ...report.viewer import flip_data
from .workbench import Workbench

__all__ = ["catalogue_record", "earlier_view", "flip_record", "pattern_view", "study_record", "view"]

#: Largest number of ranked effects in the record of a diagnosis.
_MAX_RANKED = 8

#: Reach of a slider from the null value, in small steps of its parameter. Light of the room may be as bright as the
#: lamp, and is detected at a millionth of that.
_REACH = 2000


def catalogue_record(bench: Workbench) -> list[dict[str, Any]]:
    """Records of all effects, with the names of the open capture and scene among their choices.

    Parameters
    ----------
    bench
        The workbench.

    Returns
    -------
    list of dict
        One record for each effect, by stage in the order of light: id, stage, title, summary, confirm, parameters.
    """
    effects = catalogue().values()
    return [_effect_record(effect, bench) for stage in STAGES for effect in effects if effect.stage == stage]


def study_record(bench: Workbench) -> dict[str, Any]:
    """Record of the study: captures, effects, figures of the prediction, diagnosis.

    Parameters
    ----------
    bench
        The workbench.

    Returns
    -------
    dict
        Ready for JSON; only ``open`` and ``root`` before a capture is open.
    """
    if not bench.is_open:
        return {"open": False, "root": str(bench.root), "revision": bench.revision}
    study, present = bench.study, bench.study_in_view
    prediction = bench.prediction
    fit, prepared = prediction.rendered.fit, prediction.base.validation.prepared
    moved = prepared.expected_camera(present.effects).motion_px(fit.camera, prepared.scene.corners_mm)
    return {
        "open": True,
        "root": str(bench.root),
        "revision": bench.revision,
        "saved": bench.is_saved,
        "unsaved": None if bench.unsaved_folder is None else bench.unsaved_folder.relative_to(bench.root).as_posix(),
        "moves": [_number(value) for value in bench.moves],
        "captures": [capture.manifest.name or capture.folder.name for capture in study.captures],
        "capture": bench.capture,
        "refit": bench.refit,
        "model": study.model.name,
        "rendered": prediction.exact,
        "improvable": bench.improvable,
        "can_undo": study.history.can_undo,
        "can_redo": study.history.can_redo,
        "effects": [_applied_record(effect, bench) for effect in present.effects],
        "chi2_per_dof": _number(prediction.chi2.per_dof),
        "chi2_of_captures": [_number(p.chi2.per_dof) for p in bench.predictions],
        "correlations": _correlation_record(bench),
        "profile": _profile_record(bench),
        "lamp_scale": fit.lamp_scale,
        "camera_moved_px": _number(moved),
        "diagnosis": None if bench.diagnosis is None else _diagnosis_record(bench.diagnosis),
    }


def pattern_view(bench: Workbench, effect: str) -> bytes:
    """Patterns of an effect in bytes.

    A record as of ``view``, then the (band, y, x) change by each number, in standard deviations.

    Parameters
    ----------
    bench
        The workbench.
    effect
        Identifier of the effect.

    Returns
    -------
    bytes
        The record has the effect, and the name, label, unit and value of each number.
    """
    patterns = bench.patterns(effect)
    numbers = [{**_names(each.parameter), "value": _number(each.value)} for each in patterns]
    return _packed(bench, {"effect": effect, "numbers": numbers}, [each.change_sigma for each in patterns])


def earlier_view(bench: Workbench, is_first: bool) -> bytes:
    """Prediction of an earlier state in bytes, as of ``view``.

    Parameters
    ----------
    bench
        The workbench.
    is_first
        As of ``Workbench.earlier``.

    Returns
    -------
    bytes
        The record has its reduced chi-square.
    """
    prediction = bench.earlier(is_first)
    record = {"chi2_per_dof": _number(prediction.chi2.per_dof)}
    return _packed(bench, record, [prediction.signal, prediction.sigma])


def flip_record(bench: Workbench) -> dict[str, Any]:
    """FLIP of the photograph and the predicted picture.

    Parameters
    ----------
    bench
        The workbench.

    Returns
    -------
    dict
        Ready for JSON; ``flip`` is null without a capture or without the evaluator.
    """
    if not bench.is_open:
        return {"flip": None}
    prediction = bench.prediction
    return {"flip": flip_data(prediction.base.validation.comparison, prediction.signal)}


def view(bench: Workbench) -> bytes:
    """Record of the study and its pictures in bytes.

    The first 4 bytes are the length of the record, little-endian. The record follows as JSON, padded with spaces to a
    multiple of 4. Then follow the predicted signals and their standard deviations, (band, y, x) each, as 32-bit
    little-endian numbers, bands in the order of their wavelengths.

    Parameters
    ----------
    bench
        The workbench.

    Returns
    -------
    bytes
        Only the record before a capture is open.
    """
    if not bench.is_open:
        return _packed(bench, study_record(bench), [])
    return _packed(bench, study_record(bench), [bench.prediction.signal, bench.prediction.sigma])


def _packed(bench: Workbench, record: dict[str, Any], pictures: Sequence[NDArray[np.float64]]) -> bytes:
    """A record and (band, y, x) pictures behind it, see ``view``."""
    head = json.dumps(record, allow_nan=False).encode()
    head += b" " * (-len(head) % 4)
    parts = [struct.pack("<I", len(head)), head]
    if pictures:
        responses = bench.prediction.base.validation.prepared.responses
        order = np.argsort(band_centres(responses), kind="stable")
        parts += [each[order].astype("<f4").tobytes() for each in pictures]
    return b"".join(parts)


def _applied_record(applied: AppliedEffect, bench: Workbench) -> dict[str, Any]:
    return {
        **_effect_record(applied.effect, bench),
        "values": {key: v if isinstance(v, str) else _number(v) for key, v in applied.values.items()},
        "sigma": {key: _number(value) for key, value in applied.sigma.items()},
    }


def _effect_record(effect: Effect, bench: Workbench) -> dict[str, Any]:
    return {
        "id": effect.id,
        "stage": f"{effect.stage}: {STAGE_TITLES[effect.stage]}",
        "title": effect.short_title,
        "summary": effect.summary,
        "confirm": effect.confirm,
        "parameters": [_parameter_record(p, bench) for p in effect.parameters],
    }


def _parameter_record(p: Parameter, bench: Workbench) -> dict[str, Any]:
    """Record of a parameter: choices, or bounds, null value and slider.

    ``coordinate`` holds the slider's lowest, null and highest value, in the coordinate of ``scale``. Values beyond the
    slider can be typed.
    """
    if p.choices:
        names = {}
        if bench.is_open:
            prepared = bench.study.prepared[0]
            names = names_in(prepared.scene, tuple(prepared.calibration.capture.band_ids))
        return {**_names(p), "choices": list(names.get(p.kind, p.choices) if p.kind else p.choices)}
    low, high = p.coordinate_bounds
    if math.isinf(high):
        high = low + 20 * p.step
    if p.null is not None:
        reach = _REACH * p.step
        low, high = max(low, p.null_coordinate - reach), min(high, p.null_coordinate + reach)
    return {
        **_names(p),
        "choices": [],
        "scale": p.scale,
        "low": _number(p.low),
        "high": _number(p.high),
        "null": None if p.null is None else _number(p.null),
        "coordinate": [low, None if p.null is None else p.null_coordinate, high],
    }


def _names(p: Parameter) -> dict[str, str]:
    """Name of a parameter, and its label and unit as the page prints them."""
    return {"name": p.name, "label": p.label, "unit": p.printed_unit}


def _profile_record(bench: Workbench) -> dict[str, Any] | None:
    """Effect, number, values and chi-square of the capture in view."""
    if bench.profile is None:
        return None
    which, profile = bench.profile
    return {
        "which": which,
        **_names(profile.parameter),
        "values": [_number(float(value)) for value in profile.values],
        "coordinates": [profile.parameter.to_coordinate(float(value)) for value in profile.values],
        "chi2_per_dof": [_number(float(value)) for value in profile.chi2_per_dof[bench.capture]],
        "best": _number(profile.best(bench.capture)),
    }


def _correlation_record(bench: Workbench) -> dict[str, Any] | None:
    """Names, rows and sentences of the correlations of fitted numbers."""
    matrix = bench.correlations
    if matrix is None:
        return None
    rows = [[_number(float(value)) for value in row] for row in matrix.values]
    return {"names": matrix.names, "values": rows, "sentences": matrix.sentences}


def _diagnosis_record(result: DiagnosisResult) -> dict[str, Any]:
    diagnosis = result.diagnosis
    return {
        "sentences": finding_sentences(diagnosis),
        "adequate": diagnosis.adequate,
        "selected": list(diagnosis.selected),
        "ranking": [
            {
                "id": entry.effect,
                "values": dict(entry.values),
                "text": ranked_values(entry),
                "explained": _number(explained_share(diagnosis, entry)),
                "probability": entry.probability,
            }
            for entry in diagnosis.ranking[:_MAX_RANKED]
        ],
    }


def _number(value: float | None) -> float | str | None:
    """Number for JSON, which lacks infinity and NaN: "inf" and None."""
    if value is None or math.isnan(value):
        return None
    return value if math.isfinite(value) else ("inf" if value > 0 else "-inf")
