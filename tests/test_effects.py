"""The catalogue: names as in the contract, identity at null, faults named, effects of other packages."""

from dataclasses import fields, replace

import numpy as np
import pytest
from cboxlab.scenes import InputError, Spectrum, cornell_box
from cboxlab.validate import effects
from cboxlab.validate.effects import Effect, Parameter, apply_checked, catalogue, names_in
from cboxlab.validate.hypotheses import hypotheses
from fake_stages import NM, apply, counts, start

#: Identifier, then parameters with their null value; "-" for one that has none or is a name.
CONTRACT = """
interreflection max_bounces=-
lamp-power scale=1
lamp-spectrum mired_shift=0
lamp-nonuniform edge_ratio=1
lamp-directional exponent=0
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


def test_nothing_but_the_contract_and_names_of_its_own():
    assert set(ROWS) <= set(catalogue())


@pytest.mark.parametrize("identifier", ROWS)
def test_parameters_and_null_values_are_those_of_the_contract(identifier):
    effect = catalogue()[identifier]
    wanted = dict(item.split("=") for item in ROWS[identifier])
    assert [p.name for p in effect.parameters] == list(wanted)
    for parameter in effect.parameters:
        null = None if wanted[parameter.name] == "-" else float(wanted[parameter.name])
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
def test_beside_its_null_value_an_effect_does_something(identifier):
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
        apply_checked(
            "wall-reflectance", {"material": "blue"}, "model.toml: effect[0]", names_in(cornell_box())
        )


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
    known = hypotheses(("b1", "b2"), scene, False)
    assert {h.fixed["surface"] for h in known if h.effect.id == "reflectance-gradient"} == {
        "round-block",
        "floor",
    }
    assert {h.fixed["band"] for h in known if h.effect.id == "band-gain"} == {"b1", "b2"}
    assert "blue" in {h.fixed["material"] for h in known if h.effect.id == "fluorescence"}


def test_effects_of_other_packages_come_by_their_entry_point(monkeypatch):
    loss = Parameter("loss", null=0.0)
    own = Effect("dust", "optics", "Dust on the lens.", (loss,), lambda light, loss: light, "Look.")

    class Entry:
        def load(self):
            return own

    found = {"cboxlab.effects": [Entry()]}
    monkeypatch.setattr(effects, "entry_points", lambda group: found.get(group, []))
    catalogue.cache_clear()
    try:
        assert catalogue()["dust"] is own and list(catalogue()) == sorted(catalogue())
        assert apply_checked("dust", {"loss": 0.1}, "x").values == {"loss": 0.1}
    finally:
        catalogue.cache_clear()
