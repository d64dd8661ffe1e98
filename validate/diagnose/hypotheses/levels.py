"""Odds, significance and errors of shapes that all tests of a diagnosis share."""

__all__ = [
    "CERTAIN_SIGMA",
    "EXACT_SHAPE_ERROR",
    "FALSE_ALARM",
    "INDISTINGUISHABLE_CHI2",
    "LIKELY",
    "MIN_HELDOUT_GAIN",
    "SHAPE_ERROR",
    "SIGNIFICANT_SIGMA",
]

#: Standard deviations from which a difference is certain: its square is a difference in chi2, or 2 ln of the evidence.
CERTAIN_SIGMA = 5.0

#: False-alarm probability of what is judged by noise and priors alone: an effect that camera or lamp imitate, numbers
#: with a tolerance, and a pattern of any family.
FALSE_ALARM = 3e-4

#: Difference in chi2 below which two fits do not distinguish two causes: odds of about 100 to 1.
INDISTINGUISHABLE_CHI2 = 9.2

#: Probability from which an unlisted cause keeps an effect from being named: likelier than not.
LIKELY = 0.5

#: Smallest gain in samples held out, over that in fitted ones, of a family or a flaw that is named. Pixels that scatter
#: in deep shadow have 0.2 at most; grains of nine pixels or more at least 0.4.
MIN_HELDOUT_GAIN = 0.3

#: Share of its chi2 that a cause of a wrong shape leaves: a relative error e leaves e^2. This allows for an error of
#: a tenth, or of a twentieth each in two effects that replace each other. A further effect must gain more than this
#: share of what the selected ones explain.
SHAPE_ERROR = 0.01

#: The same of a cause that is computed exactly: the warp to the fitted camera is wrong by up to 3 % of its change.
EXACT_SHAPE_ERROR = 0.001

#: Standard deviations by which two numbers must differ to count as different: 3 of 1,000 by chance.
SIGNIFICANT_SIGMA = 3.0
