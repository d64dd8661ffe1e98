"""Forms of an operator by its spectrum: in all bands alike, in each band, in one band."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from cboxlab.rendering.fitted_fields import Acts, ImageMaps

from ..field_fit import Columns, Family, FittedExplanation, NormalEquations, each_band, fixed_spectrum

__all__ = ["forms_by_spectrum"]


def forms_by_spectrum(
    family: Family, form: str, n: NormalEquations, columns: Columns, acts: Acts, maps: ImageMaps, radius: int = 1
) -> Iterator[FittedExplanation]:
    """Three fits of an operator that differ in their spectrum.

    Parameters
    ----------
    family
        Family of the forms.
    form
        The operator in words.
    n
        Normal equations of the operator.
    columns
        Changes of the signal by the operator.
    acts
        Quantity on which it acts.
    maps
        Maps over the image.
    radius
        Radius of an exchange with neighbours, px.

    Yields
    ------
    FittedExplanation
        In all bands alike, in each band otherwise, in the strongest band alone.
    """
    bands = len(n.b)
    yield FittedExplanation(family, form, fixed_spectrum(n, np.ones(bands)), columns, acts, maps, radius=radius)
    each = each_band(n)
    yield FittedExplanation(family, f"{form}, in each band otherwise", each, columns, acts, maps, radius=radius)
    strongest = int(np.argmax(each.size))
    yield FittedExplanation(
        family,
        f"{form}, in one band",
        fixed_spectrum(n, np.eye(bands)[strongest]),
        columns,
        acts,
        maps,
        sharp=True,
        num_choices=bands,
        radius=radius,
    )
