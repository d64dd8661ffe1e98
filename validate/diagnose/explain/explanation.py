"""Explanation of a residual: family, place, bands and explained share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.rendering.fitted_fields import FittedField
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from ..field_fit import Family
from .registration import Registration

__all__ = ["NONE", "NO_FORM", "SOUND", "Explanation", "Rival"]

#: Family of an explanation where nothing is left to explain, or no family explains it.
NONE = "none"

#: Form of an explanation without a family.
NO_FORM = "no family explains it"

#: Probability from which a family is named. In captures by the sixth to tenth simulator of others 13 of 15 families
#: stated at this or more were right, and 3 of 8 below it. Of 63 simulated causes left out of the fit, 29 have the right
#: family and none a wrong one; with one half 37 and 1.
_LIKELY_FAMILY = 0.75

#: Outcome that nothing but flaws of the picture differs.
SOUND = "sound"


@dataclass(frozen=True)
class Rival:
    """Best form of a family."""

    #: Identifier of the family.
    family: str
    #: The form in words.
    form: str
    #: Name of the only surface on which it acts; None where it acts on several or on none.
    surface: str | None
    #: Part of the excess of chi2 that it explains, 0 to 1.
    share: float
    #: 2 ln evidence with prior odds and allowance for shape errors; differences between rivals count.
    score: float
    #: Gain in samples held out over that in fitted ones, see ``FieldFit.predicts``.
    predicts: float = 0.0


@dataclass(frozen=True, eq=False)
class Explanation(FrozenMappings):
    """Most likely cause of a residual, with its rivals."""

    #: Identifier of the family; ``NONE`` where no family explains the residual.
    family: str
    #: The form in words, such as "rows in one band".
    form: str
    #: Name of the only surface on which it acts; None where it acts on several or on none.
    surface: str | None
    #: Centre (x, y) in the image, px; None where it is spread over the image.
    centre_px: tuple[float, float] | None
    #: Bands in which it shows.
    bands: tuple[str, ...]
    #: All bands of the capture.
    all_bands: tuple[str, ...]
    #: Part of the excess of chi2 that it explains, 0 to 1.
    share: float
    #: Whether every rival that explains enough is clearly worse.
    told_apart: bool
    #: Best form of every family, best first, the winner included.
    rivals: tuple[Rival, ...]
    #: (band, y, x) change of the signal by the likeliest family, also where it is not named, DN.
    change: NDArray[np.float64]
    #: (band, y, x) standard deviation of the measured signal, DN; NaN where unused.
    sigma: NDArray[np.float64]
    #: (band, y, x) residual over sigma that remains; NaN where unused.
    remaining: NDArray[np.float64]
    #: (band,) change over the signal where it acts.
    spectrum: NDArray[np.float64]
    #: Gain in held-out pixels over that in fitted pixels, see ``FieldFit``.
    heldout: float
    #: Decrease of chi2.
    gain: float
    #: 2 ln of the evidence over that of noise alone.
    evidence: float
    #: Number of forms that were tried.
    num_forms: int
    #: Whether rendering errors do not make such a pattern; also if it is in one place and little remains elsewhere.
    sharp: bool
    #: Part of the chi2 explained by effects that errors of their shapes may leave in such a pattern.
    effects_leave: float
    #: Fitted field, from which an effect can be made; None where no family explains the residual.
    field: FittedField | None
    #: Record of the family; None where no family explains the residual.
    family_record: Family | None
    #: Where the residual is fixed, and how it scales.
    registration: Registration
    #: Probability of each family, of "none" and of "sound", see `odds`; empty for patterns that are fitted separately.
    odds: Mapping[str, float]
    #: Whether it is a pattern that is fitted separately: its significance alone judges it.
    separate: bool = False

    @property
    def probability(self) -> float:
        """Probability of the family, or that it is none of them; NaN where odds do not judge."""
        return float("nan") if self.separate else self.odds.get(self.family, float("nan"))

    @property
    def cause_probability(self) -> float:
        """Probability of a cause other than flaws of the picture; NaN where not judged."""
        return 1 - self.odds[SOUND] if SOUND in self.odds else float("nan")

    def named_if_likely(self) -> Explanation:
        """The explanation without its family, where that is not likely enough.

        Patterns that are fitted separately keep it: they are judged by their significance alone.

        Returns
        -------
        Explanation
            With the family "none" where its probability is below three quarters. It retains the change: flaws of the
            base are sought next to it.
        """
        if self.family == NONE or self.separate or self.probability >= _LIKELY_FAMILY:
            return self
        return replace(
            self,
            family=NONE,
            form=NO_FORM,
            surface=None,
            centre_px=None,
            bands=(),
            share=0.0,
            rivals=(Rival(NONE, NO_FORM, None, 0.0, 0.0), *self.rivals),
            spectrum=np.zeros(len(self.all_bands)),
            heldout=0.0,
            field=None,
            family_record=None,
        )

    @property
    def levels(self) -> bool:
        """Whether it is one number in each band, without any shape in the image."""
        has_levels = self.family_record is not None and self.family_record.levels
        return has_levels and self.field is not None and self.field.acts not in ("previous", "radiance")

    @property
    def smear(self) -> bool:
        """Whether it is a blur along a line."""
        return self.field is not None and self.field.acts == "moments"

    @property
    def single_pixels(self) -> bool:
        """Whether it is a pattern of single pixels."""
        return self.field is not None and self.field.image is not None and self.field.image.kind == "pixels"

    @property
    def runner_up(self) -> str | None:
        """Identifier of the second-best family; None where there is one family only."""
        return self.rivals[1].family if len(self.rivals) > 1 else None
