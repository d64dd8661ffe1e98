"""Check of the exposures of a band against each other."""

from __future__ import annotations

from collections.abc import Iterator

from ..correction import CorrectedBands
from .suspicion import Suspicion

__all__ = ["check_brackets"]


def check_brackets(bands: CorrectedBands) -> Iterator[Suspicion]:
    """Name the exposure times that do not fit the counts of a band's other exposures.

    Parameters
    ----------
    bands
        Corrected bands of a capture, whose exposures were compared.

    Yields
    ------
    Suspicion
        At most one for each band.
    """
    for finding in bands.exposure_findings:
        # a band's own exposure comes first, then its brackets, see ``merged_tables``
        wrong = finding.index
        what = "an exposure time does not fit the counts"
        if wrong is None:
            what = "the exposure time of one of two exposures does not fit the counts"
        key = f"band ({finding.band})" if wrong == 0 else f"bracket ({finding.band})"
        counted = "the other exposure" if wrong is None else "the other exposures"
        yield Suspicion(
            what,
            f"{key}.exposure_s",
            f"{finding.stated_s:g} s are stated; by {counted} of {finding.band} the counts are those of "
            f"{finding.fitting_s:.3g} s ({finding.fitting_s / finding.stated_s - 1:+.1%}). "
            + ("It was left out." if wrong else "The exposures were not merged."),
        )
