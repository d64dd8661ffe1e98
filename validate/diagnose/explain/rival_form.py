"""Forms of unlisted causes in the place of selected effects.

An effect may resemble a cause that the catalogue lacks: fluorescence a filter's leak, crosstalk a camera that shook, a
shutter that opens late a step of the gain. Such forms are computed exactly and have few numbers. Each is fitted to the
residual without the effect, and their evidence is compared. A form that contains the effect pays for its further
numbers; one of the same pattern says the same in other words, and is no rival. Next to an effect on a thing in the
scene it is one: a paint and a filter are two causes, however alike they look in few bands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..families import families
from ..field_fit import Advice, FitInput, FittedExplanation, ResidualData, advice_for, change_dn
from ..hypotheses import MIN_HELDOUT_GAIN

__all__ = ["Lead", "lead_of_forms", "rival_forms"]

#: Numerics: part of an effect's square, next to a form, that rounding leaves of the same pattern.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Lead:
    """Best form of an unlisted cause in the place of an effect."""

    #: 2 ln of the evidence of the form over that of the effect.
    lead: float
    #: Title of the form's family; empty without a form.
    title: str = ""
    #: The form in words.
    form: str = ""
    #: Words for the laboratory about the form; None without a form.
    advice: Advice | None = None
    #: The same for events in single frames, see `repeats.lead_of_frames`; minus infinity where frames are alike.
    frames: float = -np.inf


def rival_forms(data: ResidualData) -> list[FittedExplanation]:
    """Forms that hold in samples held out, the one with the largest evidence first.

    Parameters
    ----------
    data
        Residual without the effect in question.

    Returns
    -------
    list of FittedExplanation
        Of filters, optics, lamp and time.
    """
    fit_input = FitInput.of(data)
    generators = (family.rivals for family in families().values() if family.rivals is not None)
    forms = (form for generate in generators for form in generate(fit_input))
    holding = (form for form in forms if form.fit.predicts >= MIN_HELDOUT_GAIN)
    return sorted(holding, key=lambda form: -form.evidence)


def lead_of_forms(
    data: ResidualData,
    together: NDArray[np.float64],
    price: float,
    averaging: float,
    shape_error: float,
    on_things: bool,
) -> Lead:
    """Lead of the best form of an unlisted cause over an effect.

    Several effects count as one. The form alone is compared with the effect alone, and with both: an effect that gains
    next to the form is another cause, and no imitation of that one.

    Parameters
    ----------
    data
        Residual without the effect.
    together
        (n,) residual with it, over sigma.
    price
        Chi2 that the effect's numbers must gain.
    averaging
        Chi2 that the effect gains by averaging noise.
    shape_error
        Part of its gain that errors of its shape may lack.
    on_things
        Whether it acts on a paint, a surface or a block. A form never says that in other words.

    Returns
    -------
    Lead
        Of the form, over the effect alone or next to the form.
    """
    residual = data.residual[data.used].astype(float)
    shape = residual - together
    rival, change = _best_rival(data, shape, 0.0 if on_things else shape_error)
    products = _marginal_products(data, np.array([residual, together, change, shape]))
    gain = products[0, 0] - products[1, 1] - averaging
    lead = (0.0 if rival is None else rival.evidence) - (gain - price)
    lead -= shape_error * gain if lead > 0 else 0.0
    # what the effect gains where the form has its best size already
    rest = products[3, 3] - products[2, 3] ** 2 / max(products[2, 2], 1e-30)
    along = products[0, 3] - products[0, 2] * products[2, 3] / max(products[2, 2], 1e-30)
    next_to_form = max(along**2 / rest - averaging, 0.0) if rest > _ROUNDING * products[3, 3] else 0.0
    # an effect that gains nothing there may be contained in the form: what the form explains beyond it decides
    lead = float(min(lead, price - next_to_form) if next_to_form > price else lead)
    if rival is None:
        return Lead(lead)
    return Lead(lead, rival.family.title, rival.form, advice_for(rival.family, rival.form))


def _best_rival(
    data: ResidualData, shape: NDArray[np.float64], alike: float
) -> tuple[FittedExplanation | None, NDArray[np.float64]]:
    """The best form whose pattern is not the effect's, and its change (n,) over sigma.

    shape : (n,) the effect's change over sigma. alike : part of its square by which a pattern that is alike differs; 0
    where none counts as alike.
    """
    for form in rival_forms(data):
        change = data.whitened(change_dn(data, form))[data.used]
        ((of_shape, cross), (_, of_change)) = _marginal_products(data, np.array([shape, change]))
        if not alike or cross**2 < (1 - alike) * of_shape * of_change:
            return form, change
    return None, np.zeros_like(shape)


def _marginal_products(data: ResidualData, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, k) products of vectors (k, n), the errors that many samples share marginalised."""
    bands = np.split(vectors, np.cumsum(data.used.sum(axis=(1, 2)))[:-1], axis=1)
    along = np.zeros((len(vectors), data.nuisances.shape[-1] - data.num_free_nuisances))
    for band, nuisances, used in zip(bands, data.nuisances, data.used, strict=True):  # all at once need a gigabyte
        along += band @ nuisances[used, data.num_free_nuisances :]
    return vectors @ vectors.T - along @ along.T
