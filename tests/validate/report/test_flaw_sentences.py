"""Sentences on the flaws of a base, and on effects that are not named next to them."""

from __future__ import annotations

from types import SimpleNamespace

from cboxlab.validation.diagnose import Flaw, Verdict
from cboxlab.validation.report.diagnosis import flaw_sentences


def test_an_effect_that_samples_held_out_refuse_is_not_said_to_miss_the_flaws():
    beside_flaws = Verdict("lamp-offset", 0.2, 86.0, 10.0, 0.86, False)
    not_beside_flaws = Verdict("gloss", 0.2, 8.0, 2.0, 0.3, False)
    named = Verdict("defocus", 0.2, 86.0, 10.0, 0.86, True)
    diagnosis = SimpleNamespace(
        flaws=(Flaw("pixels", 0.1, 1.0, 0.8),), flaws_cost=1.0, verdicts=(beside_flaws, not_beside_flaws, named)
    )
    _, first, second = flaw_sentences(diagnosis)
    assert first.startswith("lamp-offset is not reported: pixels or bands that the fit left out")
    assert second.startswith("gloss is not reported: the flaws may imitate it. With the flaws in the fit, its size is")
