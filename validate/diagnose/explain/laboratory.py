"""Words for the laboratory: place of a cause, everyday causes, and an experiment."""

from __future__ import annotations

from ..field_fit import OTHER_SIGN, Advice, advice_for
from .competition import MIN_SHARE
from .explanation import Explanation
from .registration import Registration

__all__ = ["advice", "appearance"]

#: Share of the best scaling that a second one reaches at the most to differ from it.
_SCALES_ALIKE = 0.97

#: Share of what levels of each surface explain, from which levels of each band alone are the simpler words for it.
_MOSTLY = 0.8

#: Advice where no family holds, by the attribute of `Registration` that explains most.
_WITHOUT_FAMILY = {
    "in_rows": Advice(
        "",
        "along the rows of the sensor",
        ("a fault of the read-out", "a frame whose transfer broke off", "a shutter that opens unevenly"),
        "Photograph again with the camera turned by 90 degrees: what still runs along rows is made by the sensor.",
    ),
    "in_columns": Advice(
        "",
        "along the columns of the sensor",
        ("a fault of the column amplifiers", "trapped charge", "a frame whose transfer broke off"),
        "Photograph again with the camera turned by 90 degrees: what still runs along columns is made by the sensor.",
    ),
    "in_pixels": Advice(
        "",
        "in single pixels",
        ("pixels that changed since darks and flats", "ice or dust on the sensor", "a lossy file format"),
        "Take darks and flats again right after the scene: what they take away was in the pixels.",
    ),
    "in_bands": Advice(
        "",
        "in single bands, all over the picture",
        ("a lamp or gain that changed", "a filter or exposure entered wrong", "a table of another filter"),
        "Take the first band again at the end, and measure the lamp and the filter of the band that is off.",
    ),
    "on_surfaces": Advice(
        "",
        "on surfaces of the box",
        ("a surface that was painted or moved", "light from outside", "a paint with a sheen"),
        "Photograph again from another place: what stays on its surface is in the box.",
    ),
    "at_edges": Advice(
        "",
        "at edges of the picture's surfaces",
        ("a block or wall away from its survey", "soft or filled corners", "a camera or filter that moved"),
        "Measure the corners of the blocks again, and photograph again from another place.",
    ),
    "in_places": Advice(
        "",
        "in a few places",
        ("a thing that was left in the box", "dirt on the sensor or a filter", "a reflex of the lamp"),
        "Turn the camera a little and photograph again: what stays at its pixel is in the camera.",
    ),
}

#: The same where counts are only missing, or only too many: dirt brings no light, and a reflex takes none.
_OF_ONE_SIGN = {
    ("on_surfaces", "missing"): Advice(
        "",
        "on surfaces of the box",
        ("a surface that was painted or dirtied", "a thing that shades the box", "a lamp with a dark side"),
        "Photograph again from another place: what stays on its surface is in the box.",
    ),
    ("in_places", "missing"): Advice(
        "",
        "in a few places",
        ("a stain or a dark thing in the box", "a thing in front of it", "dirt on the sensor or a filter"),
        "Turn the camera a little and photograph again: what stays at its pixel is in the camera.",
    ),
    ("in_places", "too many"): Advice(
        "",
        "in a few places",
        ("light from another source", "a reflex of the lamp", "a bright thing in the box or near the camera"),
        "Photograph with the box's lamp off, with the same exposure: what stays is other light. Then turn the camera "
        "a little and photograph again: what stays at its pixel is in the camera.",
    ),
}

#: Advice where no kind of pattern explains enough.
_SCATTERED = Advice(
    "",
    "nowhere: it is scattered over pixels and bands",
    ("noise larger than the instrument's table says", "a lossy file format", "cosmic rays"),
    "Take eight frames of one band in a row: what differs from frame to frame is noise.",
)


def advice(explanation: Explanation) -> Advice:
    """Everyday causes of what remains, and the experiment that settles it.

    Parameters
    ----------
    explanation
        The explanation of what remains.

    Returns
    -------
    Advice
        The family's for its form; by the registration where no family holds, or where it has none.
    """
    family = explanation.family_record
    of_form = None if family is None else advice_for(family, explanation.form)
    if of_form is not None:
        return of_form
    shares = {name: getattr(explanation.registration, name) for name in _WITHOUT_FAMILY}
    largest = max(shares, key=lambda name: shares[name])
    if largest == "on_surfaces" and shares["in_bands"] > _MOSTLY * shares["on_surfaces"]:
        largest = "in_bands"
    if shares[largest] < MIN_SHARE:
        return _SCATTERED
    return _OF_ONE_SIGN.get((largest, _sign(explanation.registration)), _WITHOUT_FAMILY[largest])


def _sign(registration: Registration) -> str:
    """Sign of a residual: counts that are missing, too many, or both."""
    if registration.missing > 1 - OTHER_SIGN:
        return "missing"
    return "too many" if registration.missing < OTHER_SIGN else "both"


def appearance(registration: Registration) -> str:
    """Sign and scaling of a residual in words.

    Parameters
    ----------
    registration
        The residual's registration.

    Returns
    -------
    str
        A clause, as "counts are missing, in proportion to the signal".
    """
    sign = {"missing": "counts are missing", "too many": "there are counts too many"}.get(
        _sign(registration), "counts are missing in some places and too many in others"
    )
    scalings = {
        "in proportion to the signal": registration.by_signal,
        "the same number in all bands": registration.by_count,
        "in proportion to the exposure time": registration.by_exposure,
    }
    first, second = sorted(scalings, key=lambda name: -scalings[name])[:2]
    if scalings[first] < MIN_SHARE:
        return f"{sign}, differently in each band"
    if scalings[second] > _SCALES_ALIKE * scalings[first]:
        return f"{sign}, either {first} or {second}"
    return f"{sign}, {first}"
