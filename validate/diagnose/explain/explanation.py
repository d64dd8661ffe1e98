"""Families in competition: which of them explains the excess, where, in which bands, and how much of it."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain, takewhile
from threading import Event
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import FittedField
from cboxlab.utils.progress import NO_PROGRESS, Progress
from numpy.typing import NDArray

from .as_field import fitted_field
from .excess import Excess
from .form import Form, changed
from .optics_forms import moves_of_bands, optics_forms, smears, uneven_blurs
from .order_forms import order_forms
from .sensor_forms import sensor_forms
from .spot_cells import hot_spot, spot_of_one_band
from .spots import fits_the_place, soft_outline
from .surface_forms import surface_forms

__all__ = ["FAMILIES", "NONE", "Explanation", "Rival", "explain", "hidden"]

#: Where nothing is left to explain, or no family explains it.
NONE = "none"

FAMILIES = (
    "sensor-offset",
    "sensor-gain",
    "displacement",
    "blur",
    "time-order",
    "reflectance-map",
    "paint-spectrum",
    "lamp-spectrum",
    "extra-light",
    "object",
    "reflection-lobe",
    NONE,
)

#: Families of which a band has one number, whatever the place, unless a frame's picture is seen in the next one.
_LEVELS = ("time-order", "lamp-spectrum")

#: A family whose shapes are this much wrong in chi2 is not behind one that follows the residual more closely: the
#: exchange between patches and first derivatives are no better.
_SHAPE_ERROR = 0.03

#: The same of a form in one place: all are made of the same bells, and have the errors of an outline in common.
_SHAPE_ERROR_OF_PLACE = 0.01

#: Two families whose scores differ by less than this, or by this part of the gain, cannot be told apart.
_TOLD_APART, _TOLD_APART_PART = 12.0, 0.002

#: A family must explain this part of the excess, and gain this much evidence.
_LEAST_SHARE, _LEAST_EVIDENCE = 0.2, 40.0

#: A band shows the cause where it has this part of the strongest band's gain, and this much chi2.
_BAND_PART, _BAND_CHI2 = 0.02, 25.0

#: What changes a reflectance or the lamp shows in a band where the light changes by this part of the most.
_SPECTRAL, _SPECTRAL_PART = ("paint-spectrum", "lamp-spectrum", "reflectance-map"), 0.1

#: Median of the absolute value of a normal variable; squares beyond this are cut off (edges that the model misses).
_MEDIAN_OF_NORMAL, _MOST_SQUARE = 0.6745, 9.0

#: Errors of the picture are in several places, as dark corners are: a cause in one place explains this part of the
#: excess.
_ALONE = 0.75

#: A change has a place where half of its weight lies within this part of the picture's width about its centre.
_PLACE = 0.13


@dataclass(frozen=True)
class Rival:
    """A family's best form. share : of the excess that it explains. score : see ``_scores``; differences count."""

    family: str
    words: str
    surface: str | None
    share: float
    score: float


@dataclass(frozen=True, eq=False)
class Explanation:
    """What the residual is most likely made by.

    family : one of FAMILIES. words : the form. surface : on which it acts alone. centre_px : (x, y), None where it is
    everywhere. bands : in which it shows, of all_bands. share : 0 to 1 of the excess. told_apart : whether the
    runner-up is clearly worse. rivals : the best form of every family, best first, the winner included. change :
    (band, y, x) DN explained. sigma : (band, y, x) DN of a pixel's noise, NaN where unused. left : (band, y, x)
    residual over sigma that stays, NaN where unused. spectrum : (band,) the change over the signal where it acts.
    heldout : see ``FieldFit``. gain : chi2 that it lowers. evidence : 2 ln over noise alone.
    forms : number of forms that were tried. sharp, effects_leave : see ``Form``; what is in one place is sharp, too, if
    hardly anything is left elsewhere. field : what an effect is made of;
    None where no family explains it.
    """

    family: str
    words: str
    surface: str | None
    centre_px: tuple[float, float] | None
    bands: tuple[str, ...]
    all_bands: tuple[str, ...]
    share: float
    told_apart: bool
    rivals: tuple[Rival, ...]
    change: NDArray[np.float64]
    sigma: NDArray[np.float64]
    left: NDArray[np.float64]
    spectrum: NDArray[np.float64]
    heldout: float
    gain: float
    evidence: float
    forms: int
    sharp: bool
    effects_leave: float
    field: FittedField | None

    @property
    def levels(self) -> bool:
        """Whether it is one number in each band, without any shape in the picture."""
        return self.family in _LEVELS and self.field is not None and self.field.acts != "previous"

    @property
    def smear(self) -> bool:
        """Whether it is a blur along a line."""
        return self.field is not None and self.field.acts == "moments"

    @property
    def runner_up(self) -> str | None:
        """The next family."""
        return self.rivals[1].family if len(self.rivals) > 1 else None


def explain(excess: Excess, progress: Progress = NO_PROGRESS) -> Explanation:
    """Fit all families to the excess and judge them."""
    spot, forms = hot_spot(excess), []
    of_camera = chain(sensor_forms(excess, spot, spot_of_one_band(excess)), optics_forms(excess), order_forms(excess))
    stopped = Event()
    with ThreadPoolExecutor(1) as beside:  # half of the work is on surfaces
        others = beside.submit(lambda: list(takewhile(lambda _: not stopped.is_set(), of_camera)))
        try:
            for form in surface_forms(excess, spot):
                forms.append(form)
                progress.part(0.0)  # again and again: how many forms there are is not known before
            return _judged(excess, [*others.result(), *forms])
        except BaseException:  # cancelled: the other thread ends at its next form
            stopped.set()
            raise


def hidden(excess: Excess) -> tuple[Explanation, ...]:
    """Fit blurs along a line and uneven ones, and displacements that differ between bands, each alone: errors of the
    picture, which explain more, hide them."""
    kinds = smears(excess), uneven_blurs(excess), moves_of_bands(excess)
    return tuple(_judged(excess, [*forms], least_share=0.0) for forms in kinds)


def _judged(excess: Excess, forms: Sequence[Form], least_share: float = _LEAST_SHARE) -> Explanation:
    total = max(excess.chi2 - noise_level(excess.residual, excess.used) * excess.count, 1.0)
    scores = _scores(excess, forms)
    best: dict[str, tuple[float, Form]] = {}
    for score, form in sorted(zip(scores, forms, strict=True), key=lambda pair: -pair[0]):
        best.setdefault(form.family, (score, form))
    each = ((_share(excess, form, total), score, form) for score, form in best.values())
    # families that explain too little of the excess come behind all others
    ranked = sorted(each, key=lambda one: (one[0] < least_share, -one[1]))
    rivals = tuple(Rival(form.family, form.words, form.surface, share, score) for share, score, form in ranked)
    _, score, winner = ranked[0]
    margin = max(_TOLD_APART, _TOLD_APART_PART * winner.fit.gain)
    if winner.evidence < _LEAST_EVIDENCE or rivals[0].share < least_share:
        return _nothing(excess, rivals, len(forms))
    change = changed(excess, winner)
    whitened = excess.whitened(change)
    weight, sizes = np.sum(whitened**2, axis=0), np.sum(whitened**2, axis=(1, 2))
    shown = np.any(change, axis=(1, 2)) & (sizes > np.maximum(_BAND_PART * sizes.max(), _BAND_CHI2))
    spectrum = _spectrum(excess, change, weight)
    if winner.family in _SPECTRAL:
        shown &= np.abs(spectrum) >= _SPECTRAL_PART * np.abs(spectrum).max()
    return Explanation(
        family=winner.family,
        words=winner.words,
        surface=winner.surface,
        centre_px=None if winner.family in _EVERYWHERE else place(weight),
        bands=tuple(band for band, one in zip(excess.bands, shown, strict=True) if one),
        all_bands=excess.bands,
        share=rivals[0].share,
        told_apart=all(score - rival.score > margin for rival in rivals[1:] if rival.share >= least_share),
        rivals=rivals,
        change=change,
        sigma=np.where(excess.used, excess.sigma, np.nan),
        left=np.where(excess.used, excess.residual - whitened, np.nan),
        spectrum=spectrum,
        heldout=winner.fit.heldout,
        gain=winner.fit.gain,
        evidence=winner.evidence,
        forms=len(forms),
        sharp=winner.sharp or (winner.local and rivals[0].share > _ALONE),
        effects_leave=winner.effects_leave,
        field=fitted_field(excess, winner),
    )


def _share(excess: Excess, form: Form, total: float) -> float:
    """The part of the excess of chi2 over noise that a form explains."""
    change = excess.whitened(changed(excess, form))
    return float(np.clip((2 * np.sum(change * excess.residual) - np.sum(change**2)) / total, 0, 1))


#: Families of which a place would say nothing.
_EVERYWHERE = ("paint-spectrum", "lamp-spectrum", "time-order")


def _nothing(excess: Excess, rivals: Sequence[Rival], forms: int) -> Explanation:
    zero = np.zeros(excess.used.shape)
    return Explanation(
        NONE,
        "no family explains it",
        None,
        None,
        (),
        excess.bands,
        0.0,
        True,
        (Rival(NONE, "no family explains it", None, 0.0, 0.0), *rivals),
        zero,
        np.where(excess.used, excess.sigma, np.nan),
        np.where(excess.used, excess.residual, np.nan),
        np.zeros(len(excess.bands)),
        0.0,
        0.0,
        0.0,
        forms,
        False,
        0.0,
        None,
    )


def _scores(excess: Excess, forms: Sequence[Form]) -> list[float]:
    """2 ln evidence of each form, with what it lacks to the largest gain forgiven as far as shapes are in error, and
    with what is known of the places of such things."""
    most = max(form.fit.gain for form in forms)
    soft = any(form.family == "object" and soft_outline(excess, form) for form in forms)
    found = []
    for form in forms:
        complexity = form.fit.gain - form.evidence
        forgiven = _SHAPE_ERROR_OF_PLACE if form.local else _SHAPE_ERROR
        lacks = max(most - form.fit.gain - forgiven * most, 0.0)
        found.append(most - lacks - complexity + fits_the_place(excess, form, soft))
    return found


def noise_level(residual: NDArray[np.floating], used: NDArray[np.bool_]) -> float:
    """Chi2 per sample that noise alone makes of a residual (band, y, x): mixed second differences know no rows, columns
    or smooth patterns. 1 at most: noise is no larger than stated."""
    r = residual.astype(float)
    four = used[:, 1:, 1:] & used[:, 1:, :-1] & used[:, :-1, 1:] & used[:, :-1, :-1]
    mixed = (r[:, 1:, 1:] - r[:, 1:, :-1] - r[:, :-1, 1:] + r[:, :-1, :-1])[four] / 2
    level = (np.median(np.abs(mixed)) / _MEDIAN_OF_NORMAL) ** 2
    return float(min(level * np.minimum(mixed**2 / level, _MOST_SQUARE).mean(), 1.0))


def place(weight: NDArray[np.float64]) -> tuple[float, float] | None:
    """The centre (x, y) of a weight (y, x), None where it is spread over the picture.

    Medians: of a spot with wide flanks in a corner they lie nearer to it than means do.
    """
    total = float(weight.sum())
    if not total > 0:
        return None
    rows, columns = np.indices(weight.shape)
    x, y = _median(weight.sum(axis=0)), _median(weight.sum(axis=1))
    near = np.hypot(columns - x, rows - y) < _PLACE * max(weight.shape)
    return (x, y) if weight[near].sum() > total / 2 else None


def _median(weight: NDArray[np.float64]) -> float:
    """The place, px, that halves a weight by pixel; pixels are even inside."""
    total = np.concatenate([[0.0], np.cumsum(weight)])
    return float(np.interp(total[-1] / 2, total, np.arange(len(total)) - 0.5))


def _spectrum(excess: Excess, change: NDArray[Any], weight: NDArray[Any]) -> NDArray[np.float64]:
    where = weight >= 0.25 * weight.max() if weight.max() > 0 else np.zeros(weight.shape, bool)
    found = []
    for band in range(len(excess.bands)):
        own = where & excess.used[band]
        found.append(float(change[band][own].sum() / max(excess.signal[band][own].sum(), 1e-9)) if own.any() else 0.0)
    return np.array(found)
