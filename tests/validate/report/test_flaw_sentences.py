"""Sentences on the flaws of a base, and on effects that are not named next to them."""

from __future__ import annotations

from types import SimpleNamespace

from cboxlab.validation.diagnose import Flaw, Verdict
from cboxlab.validation.diagnose.explain import Lead
from cboxlab.validation.report.diagnosis import doubt_sentences, flaw_sentences


def test_an_effect_that_is_not_named_has_its_true_reason():
    unconfirmed = Verdict("lamp-offset", 0.2, 86.0, 10.0, 0.86, False)
    imitation = Verdict("gloss", 0.2, 40.0, 6.0, 0.3, False)
    needless = Verdict("smear", 0.06, 20.0, 5.9, 1.01, False)
    reversed_ = Verdict("haze", 0.2, 8.0, -2.3, -15.5, False)
    without_gain = Verdict("ghost", -0.1, 8.0, 2.0, 0.3, False)
    accepted = Verdict("defocus", 0.2, 86.0, 10.0, 0.86, True)
    replaced = Verdict("shutter-offset", 0.4, 86.0, 19.0, 0.97, False)
    diagnosis = SimpleNamespace(
        selected=("defocus",),
        flaws=(Flaw("pixels", 0.1, 1.0, 0.8),),
        flaws_cost=1.0,
        verdicts=(unconfirmed, imitation, needless, reversed_, without_gain, replaced, accepted),
        doubts={
            "shutter-offset": Lead(60.0, "a change in time", "a step of the lamp"),
            "defocus": Lead(-3.0, "a blur", "a line"),
        },
    )
    start, pixels, first, second, third, fourth = flaw_sentences(diagnosis)
    assert start == "Small flaws of the scene, the survey or the flats explain part of the difference."
    assert pixels.startswith("Single pixels, alike in all bands,") and pixels.endswith("explain 0.10 of χ² per sample.")
    assert first.startswith("lamp-offset is not reported: pixels or bands that the fit left out")
    assert second.startswith("gloss is not reported: the flaws may imitate it. With the flaws in the fit, its size is")
    assert third == "smear is not reported: the flaws explain the difference about as well without it."
    assert fourth == "haze is not reported: with the flaws in the fit, nothing remains of it."
    first, second = doubt_sentences(diagnosis)
    assert first.startswith("shutter-offset is not reported: a change in time (a step of the lamp) explains")
    assert second.startswith("This capture cannot distinguish defocus from a blur (a line)")


def test_a_paint_within_its_tolerance_is_stated_with_the_experiment_that_settles_it():
    verdicts = (Verdict("fluorescence", 0.04, -1.3, 4.0, 0.96, False),)
    for kinds, paints in ((("pixels", "paints", "creases"), True), (("creases", "paints"), False)):
        flaws = tuple(Flaw(kind, 0.1 - 0.01 * k, 0.7, 0.9) for k, kind in enumerate(kinds))
        diagnosis = SimpleNamespace(selected=(), flaws=flaws, flaws_cost=1.0, verdicts=verdicts, doubts={})
        *_, last = flaw_sentences(diagnosis)
        assert ("cannot distinguish it from paints within their tolerance" in last) == paints
        assert ("400 nm filter" in last) == paints
