"""Effects that a capture without absolute scale cannot show: its free factors do the same to the picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..compare import FreeScale
from .linearised_fit import LinearisedFit
from .search import Signature

__all__ = ["free_factor_notes", "without_imitated"]

#: Share of an effect's chi2 that free factors leave, below which it is no candidate: ten times its size would be needed
#: for the evidence that it otherwise gives.
_MIN_LEFT_SHARE = 0.01


def without_imitated(
    linearised: LinearisedFit, signatures: Sequence[Signature]
) -> tuple[list[Signature], tuple[str, ...]]:
    """Signatures that free factors of the capture do not imitate.

    Parameters
    ----------
    linearised
        Linearised fit of the capture.
    signatures
        Signatures of the hypotheses.

    Returns
    -------
    list of Signature
        The others; all of them for a capture with an absolute scale.
    tuple of str
        Identifiers of the effects left out, in order.
    """
    if linearised.free_changes is None:
        return list(signatures), ()
    model = linearised.model
    factors = np.array([change / model.sigma for change in (model.by_lamp, *linearised.free_changes)]).T
    basis = np.linalg.qr(factors / np.linalg.norm(factors, axis=0))[0]
    kept: list[Signature] = []
    imitated: dict[str, None] = {}
    for signature in signatures:
        if signature.hypothesis.effect.imitates_lamp_power or _is_imitated(basis, signature, model.sigma):
            imitated[signature.hypothesis.effect.id] = None
        else:
            kept.append(signature)
    still = {signature.hypothesis.effect.id for signature in kept}
    return kept, tuple(effect for effect in imitated if effect not in still)


def _is_imitated(basis: NDArray[np.float64], signature: Signature, sigma: NDArray[np.float64]) -> bool:
    """Whether all changes of a signature lie in the space of the free factors, but for a small share."""
    if signature.changes is None or not len(signature.changes):
        return False
    changes = np.asarray(signature.changes, float) / sigma
    left = changes - (changes @ basis) @ basis.T
    sizes = np.sum(changes**2, axis=1)
    return bool(np.all(np.sum(left**2, axis=1) <= _MIN_LEFT_SHARE * np.maximum(sizes, 1e-300)))


def free_factor_notes(scale: FreeScale | None, imitated: Sequence[str]) -> tuple[str, ...]:
    """Sentences on what a capture without absolute scale cannot show.

    Parameters
    ----------
    scale
        Factors of the capture; None for an absolute scale.
    imitated
        Identifiers of effects that are no candidates.

    Returns
    -------
    tuple of str
        Empty for an absolute scale.
    """
    if scale is None:
        return ()
    factor = "one free factor of each band" if scale.by_band else "one free factor of all bands"
    fall_off = " and the lens's fall-off is fitted" if scale.nominal_fall_off else ""
    sentence = f"The capture claims no absolute scale: {factor} is estimated{fall_off}."
    if imitated:
        sentence += f" Effects that do the same to the picture are no candidates: {', '.join(imitated)}."
    return (sentence,)
