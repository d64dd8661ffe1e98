"""Chapters of a report on a comparison without a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..compare import Comparison
from .bands import NamedBand
from .blocks import Headline, ReportSection, Story
from .plots import map_row, residual_scale
from .verdict import verdict

__all__ = ["NOTHING_MISSING", "beyond_adequate", "pooled", "story_without"]

#: Sentence on an adequate model.
NOTHING_MISSING = "This capture shows nothing that the model lacks."


def pooled(values: NDArray) -> NDArray[np.float64]:
    """Sum over the bands used, over its standard deviation.

    Parameters
    ----------
    values
        (band, y, x) values over sigma; NaN where a sample is left out.

    Returns
    -------
    NDArray
        (y, x) with the noise of one band; NaN without a band.
    """
    used = np.isfinite(values)
    count = used.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count > 0, np.where(used, values, 0.0).sum(axis=0) / np.sqrt(count), np.nan)


def story_without(c: Comparison, bands: Sequence[NamedBand]) -> Story:
    """Chapters of a comparison without a diagnosis.

    Parameters
    ----------
    c
        The comparison.
    bands
        Bands in the order of the page.

    Returns
    -------
    Story
        The verdict, and the advice to run a diagnosis where the model is not adequate.
    """
    result = verdict(c, bands)
    residual = pooled(c.maps["residual_over_sigma"].values)
    picture = map_row({"Photograph minus rendering, all bands": residual}, residual_scale())
    adequate = result.level == "explained"
    sentence = (
        "The model is adequate: noise explains the difference."
        if adequate
        else f"{result.headline} No diagnosis looked for the cause."
    )
    advice = (
        "Run a diagnosis of this capture: it tries every effect of the catalogue and names those that the model lacks."
    )
    return Story(
        Headline(sentence, result.details, picture),
        ReportSection(
            "What is missing",
            (NOTHING_MISSING if adequate else "No diagnosis looked for the cause.",),
        ),
        None,
        ReportSection("What to do next", steps=beyond_adequate() if adequate else (advice,)),
    )


def beyond_adequate() -> tuple[str, ...]:
    """Steps after the result that the model is adequate.

    Returns
    -------
    tuple
        Sentences.
    """
    return (
        "You need not add anything to the model.",
        "If you take more frames per band, the noise falls and may reveal smaller errors of the model.",
    )
