"""Sentence on what remains where no family is likelier than not."""

from __future__ import annotations

from types import SimpleNamespace

from cboxlab.validation.report.explanation import explanation_sentence


def sentence(**odds):
    odds = {name.replace("_", "-"): value for name, value in odds.items()}
    return explanation_sentence(SimpleNamespace(family_record=None, odds=odds, probability=odds["none"]))


def test_families_that_are_likely_together_are_listed_with_their_probabilities():
    text = sentence(extra_light=0.39, sensor_offset=0.15, reflection_lobe=0.147, reflectance_map=0.087, none=0.006)
    assert "does not distinguish them" in text
    assert text.endswith("[sensor-offset] (0.15) and a reflection that depends on the angle [reflection-lobe] (0.15).")
    assert "[extra-light] (0.39), " in text and "reflectance-map" not in text


def test_no_family_explains_where_that_is_likeliest():
    assert sentence(none=0.6, blur=0.3) == "No family of fields explains what remains (probability 0.60)."
    assert "not distinguish" not in sentence(sound=0.5, none=0.3, blur=0.1)
