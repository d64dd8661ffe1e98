"""Forms of unlisted causes in the place of a selected effect.

An effect may resemble a cause that the catalogue lacks: fluorescence a filter's leak, crosstalk a camera that shook.
Forms of filters and optics are computed exactly and have few numbers. Each is fitted to the residual without the
effect, and their evidence is compared. A form that contains the effect pays for its further numbers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..families import families
from ..field_fit import FitInput, FittedExplanation, ResidualData, change_dn
from .competition import MIN_HELDOUT_GAIN

__all__ = ["best_rival_form", "lead_of_forms"]


def best_rival_form(data: ResidualData) -> FittedExplanation | None:
    """Form of filters or optics with the largest evidence.

    Parameters
    ----------
    data
        Residual without the effect in question.

    Returns
    -------
    FittedExplanation or None
        None where no form holds in samples held out.
    """
    fit_input = FitInput.of(data)
    forms = (form for family in families().values() if family.exact for form in family.generate(fit_input))
    holding = (form for form in forms if form.fit.predicts >= MIN_HELDOUT_GAIN)
    return max(holding, key=lambda form: form.evidence, default=None)


def lead_of_forms(
    data: ResidualData, together: NDArray[np.float64], price: float, averaging: float, shape_error: float
) -> float:
    """Lead of the best form of an unlisted cause over an effect.

    The form alone is compared with the effect alone, and with both: an effect that gains next to the form is another
    cause, and no imitation of that one.

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

    Returns
    -------
    float
        2 ln of the evidence of the form over that of the effect, alone or next to the form.
    """
    rival, residual = best_rival_form(data), data.residual[data.used].astype(float)
    shape = residual - together
    change = np.zeros_like(shape) if rival is None else data.whitened(change_dn(data, rival))[data.used]
    products = _marginal_products(data, np.array([residual, together, change, shape]))
    gain = products[0, 0] - products[1, 1] - averaging
    lead = (0.0 if rival is None else rival.evidence) - (gain - price)
    lead -= shape_error * gain if lead > 0 else 0.0
    # what the effect gains where the form has its best size already
    rest = products[3, 3] - products[2, 3] ** 2 / max(products[2, 2], 1e-30)
    along = products[0, 3] - products[0, 2] * products[2, 3] / max(products[2, 2], 1e-30)
    next_to_form = max(along**2 / max(rest, 1e-30) - averaging, 0.0)
    return float(min(lead, price - next_to_form))


def _marginal_products(data: ResidualData, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, k) products of vectors (k, n), the errors that many samples share marginalised."""
    shared = data.nuisances[data.used][:, data.num_free_nuisances :]
    along = vectors @ shared
    return vectors @ vectors.T - along @ along.T
