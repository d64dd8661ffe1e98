"""The catalogue: names as in the contract, identity at null, faults named, effects of other packages."""

from dataclasses import fields, replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.rendering.effects import Parameter, apply_checked, catalogue, names_in
from cboxlab.scenes import Spectrum, cornell_box
from cboxlab.utils import other_packages
from cboxlab.utils.errors import InputError
from cboxlab.validation.diagnose.hypotheses import hypotheses
from helpers.fakes.stages import NM, apply, counts, start

#: Identifier, then parameters with their null value; "-" for one that has none or is a name.
CONTRACT = """
interreflection max_bounces=-
lamp-power scale=1
lamp-spectrum mired_shift=0
lamp-nonuniform edge_ratio=1
lamp-directional exponent=0
lamp-reflectance reflectance=0.78
lamp-offset dx_mm=0 dz_mm=0
wall-reflectance material=- scale=1
reflectance-gradient surface=- axis=- amplitude=0
gloss material=- specular=0 roughness=-
rough-diffuse material=- sigma_rad=0
fluorescence material=- yield=0 peak_nm=-
block-pose block=- dx_mm=0 dz_mm=0 yaw_deg=0
ambient-light radiance=0 spectrum=-
haze extinction_per_m=0 albedo=-
defocus sigma_px=0
chromatic-focus sigma_px_per_100nm=0
veiling-glare fraction=0
ghost fraction=0
lateral-colour ppm_per_nm=0
lens-distortion k1=0
camera-pose rx_deg=0 ry_deg=0 rz_deg=0 tx_mm=0 ty_mm=0 tz_mm=0
vignetting edge_loss=0
filter-leak fraction=0
filter-shift effective_index=inf
band-gain band=- scale=1
dark-offset dn=0
nonlinearity b=0
shutter-offset seconds=0
lamp-drift per_minute=0
crosstalk fraction=0
smear fraction=0
"""
ROWS = {line.split()[0]: line.split()[1:] for line in CONTRACT.split("\n") if line}


def arrays(value) -> list[np.ndarray]:
    """Everything in a value that an effect could change, as arrays."""
    if isinstance(value, tuple | list):
        return [array for item in value for array in arrays(item)]
    if isinstance(value, dict):
        return arrays(list(value.values()))
    if isinstance(value, Spectrum):
        return [value.at(NM)]
    if hasattr(value, "__dataclass_fields__"):
        return arrays([getattr(value, field.name) for field in fields(value)])
    return [np.asarray(value)] if isinstance(value, int | float | np.ndarray) else []


def test_an_effect_uses_only_the_contract_and_its_names():
    assert set(ROWS) <= set(catalogue())


@pytest.mark.parametrize("identifier", ROWS)
def test_parameters_and_null_values_are_those_of_the_contract(identifier):
    effect = catalogue()[identifier]
    expected = dict(item.split("=") for item in ROWS[identifier])
    assert [p.name for p in effect.parameters] == list(expected)
    for parameter in effect.parameters:
        null = None if expected[parameter.name] == "-" else float(expected[parameter.name])
        assert parameter.null == null
        if not parameter.choices:
            assert parameter.low < parameter.high and parameter.step > 0
            assert null is None or parameter.low <= null <= parameter.high
    assert len(effect.summary) > 30 and len(effect.confirm) > 30


@pytest.mark.parametrize("identifier", [i for i, e in catalogue().items() if e.stage != "transport"])
def test_at_its_null_value_an_effect_does_nothing(identifier):
    effect = catalogue()[identifier]
    value = start(effect)
    nulls = {"max_bounces": 3.0} if identifier == "interreflection" else {}
    for before, after in zip(arrays(value), arrays(apply(identifier, value, **nulls)), strict=True):
        np.testing.assert_allclose(after, before, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("identifier", [i for i, e in catalogue().items() if e.stage != "transport"])
def test_away_from_its_null_value_an_effect_does_something(identifier):
    """And it leaves its argument as it was."""
    effect = catalogue()[identifier]
    value, untouched = start(effect), start(effect)
    special = {
        "filter-shift": {"effective_index": 1.6},
        "lamp-nonuniform": {"edge_ratio": 0.9},
        "interreflection": {},
    }
    usual = {p.name: p.null + p.step for p in effect.numbers if p.null is not None}
    changed = apply(identifier, value, **special.get(identifier, usual))
    pairs = zip(arrays(value), arrays(changed), strict=False)
    assert len(arrays(value)) != len(arrays(changed)) or any(not np.array_equal(a, b) for a, b in pairs)
    for before, after in zip(arrays(value), arrays(untouched), strict=True):
        np.testing.assert_array_equal(before, after)


def test_unknown_names_are_refused_with_what_is_known():
    with pytest.raises(InputError, match="f550"):
        apply("band-gain", counts(), band="f600", scale=1.1)
    with pytest.raises(InputError, match="veiling-glare"):
        apply_checked("veiling-glaer", {}, "model.toml: effect[0]")
    with pytest.raises(InputError, match=r"effect\[0\].fractoin"):
        apply_checked("ghost", {"fractoin": 0.1}, "model.toml: effect[0]")
    for wrong in (0.9, -0.1, "much", True, float("nan")):
        with pytest.raises(InputError, match=r"from 0 to 0\.5"):
            apply_checked("ghost", {"fraction": wrong}, "model.toml: effect[0]")
    with pytest.raises(InputError, match="white, red, green"):
        apply_checked("wall-reflectance", {"material": "blue"}, "model.toml: effect[0]", names_in(cornell_box()))


def test_effects_name_what_the_scene_holds():
    """Another scene has other paints, surfaces, blocks and bands than the published box."""
    box = cornell_box()
    surfaces = (replace(box.surface("tall-block"), name="round-block", material="blue"), box.surface("floor"))
    scene = replace(box, surfaces=surfaces, materials={**box.materials, "blue": box.materials["red"]})
    names = names_in(scene)
    assert names["block"] == ("round",)
    blue = apply_checked("gloss", {"material": "blue", "specular": 0.1, "roughness": 0.2}, "x", names)
    assert blue.values["material"] == "blue"
    with pytest.raises(InputError, match="one of round"):
        apply_checked("block-pose", {"block": "tall"}, "x", names)
    with pytest.raises(InputError, match="blue"):
        apply_checked("wall-reflectance", {"material": "violet", "scale": 1.1}, "x").apply(scene)
    catalogue = hypotheses(("b1", "b2"), scene, RenderSettings())
    assert {h.fixed["surface"] for h in catalogue if h.effect.id == "reflectance-gradient"} == {
        "round-block",
        "floor",
    }
    assert {h.fixed["band"] for h in catalogue if h.effect.id == "band-gain"} == {"b1", "b2"}
    assert "blue" in {h.fixed["material"] for h in catalogue if h.effect.id == "fluorescence"}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("nowhere:EFFECT", "nowhere"),
        ("math:pi", "a float"),
        ("cboxlab.rendering.effects.ghost:EFFECT", "'ghost'"),
    ],
)
def test_an_entry_point_that_is_no_new_effect_is_named(monkeypatch, value, message):
    entry = EntryPoint("dust", value, "cboxlab.effects")
    monkeypatch.setattr(other_packages, "entry_points", lambda group: [entry])
    catalogue.cache_clear()
    try:
        with pytest.raises(InputError, match=f"dust = {value}.*{message}"):
            catalogue()
    finally:
        catalogue.cache_clear()


def test_fields_that_contradict_each_other_are_refused():
    with pytest.raises(ValueError, match="inverse square"):
        Parameter("index", null=np.inf)
    with pytest.raises(ValueError, match="choices"):
        Parameter("paint", kind="material")


def test_a_number_and_its_coordinate():
    """n^-2 goes back to n, infinity is 0, bounds turn around; small steps lead inside the bounds."""
    index = Parameter("index", null=np.inf, low=1.25, step=0.05, scale="inverse square")
    assert index.coordinate_bounds == (0.0, 0.64)
    assert index.null_coordinate == 0.0 and index.from_coordinate(0.0) == np.inf
    assert index.from_coordinate(index.to_coordinate(1.6)) == pytest.approx(1.6)
    ends = [index.from_coordinate(1.6**-2 + sign * 1e-6) for sign in (-1, 1)]
    assert index.deviation(1.6, 1e-6) == pytest.approx((ends[0] - ends[1]) / 2, rel=1e-4)
    ratio = Parameter("ratio", null=1.0, low=0.0, high=1.0, step=0.1)
    assert ratio.coordinate_step == -0.1 and ratio.from_coordinate(1.3) == 1.0
    assert ratio.deviation(0.7, 0.02) == 0.02
    assert Parameter("peak", low=400.0, high=600.0).starting_values == (500.0,)
    assert Parameter("part", low=0.0, high=1.0, default=0.0).starting_values == (0.0,)
