"""What is frozen shares no mutable dictionary with anyone."""

import importlib
import json
import pickle
import pkgutil
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace

import pytest
from cboxlab import calibration, rendering, scenes, validation
from cboxlab.rendering.device import dr, mi
from cboxlab.scenes import Material, cornell_box
from cboxlab.utils.frozen import FrozenMappings


@dataclass(frozen=True)
class Owner(FrozenMappings):
    plain: Mapping[str, float]
    nested: Mapping[str, object]
    several: tuple[Mapping[str, float], ...] = ()
    optional: Mapping[str, float] | None = None
    cache: dict[str, float] = field(default_factory=dict, init=False)


def test_a_change_of_the_dictionary_passed_in_does_not_reach_the_object():
    plain, nested, shared = {"a": 1.0}, {"inner": {"list": [{"b": 2.0}]}}, {"c": 3.0}
    owner = Owner(plain, nested, (shared,), types.MappingProxyType(plain))
    plain["a"] = shared["c"] = 9.0
    nested["inner"]["list"][0]["b"] = 9.0
    assert owner.plain == {"a": 1.0} == owner.optional
    assert owner.nested == {"inner": {"list": [{"b": 2.0}]}}
    assert owner.several == ({"c": 3.0},)


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.__setitem__("a", 2.0),
        lambda d: d.__delitem__("a"),
        lambda d: d.update(a=2.0),
        lambda d: d.clear(),
        lambda d: d.pop("a"),
        lambda d: d.popitem(),
        lambda d: d.setdefault("b", 2.0),
        lambda d: d.__ior__({"a": 2.0}),
    ],
)
def test_the_objects_own_dictionaries_refuse_every_change(change):
    owner = Owner({"a": 1.0}, {"inner": {"a": 1.0}}, ({"a": 1.0},))
    for frozen in (owner.plain, owner.nested, owner.nested["inner"], owner.several[0]):
        with pytest.raises(TypeError, match="frozen"):
            change(frozen)
    assert owner == Owner({"a": 1.0}, {"inner": {"a": 1.0}}, ({"a": 1.0},))


def test_it_is_pickled_and_written_as_before():
    owner = Owner({"a": 1.0}, {"inner": {"b": [1, 2]}})
    assert pickle.loads(pickle.dumps(owner)) == owner
    assert json.loads(json.dumps(owner.nested)) == {"inner": {"b": [1, 2]}}
    with pytest.raises(TypeError, match="frozen"):
        pickle.loads(pickle.dumps(owner)).plain["a"] = 2.0


def test_a_copy_has_a_separate_cache():
    first = Owner({}, {})
    first.cache["a"] = 1.0
    assert replace(first, plain={"b": 1.0}).cache == {}


def test_a_scene_keeps_its_paints():
    box = cornell_box()
    materials = dict(box.materials)
    other = replace(box, materials=materials)
    materials["white"] = Material("white", materials["red"].reflectance, {"type": "diffuse"})
    assert other.materials["white"] is box.materials["white"]
    with pytest.raises(TypeError, match="frozen"):
        other.materials["white"] = materials["white"]


def frozen_classes():
    for room in (scenes, calibration, rendering, validation):
        for module in pkgutil.walk_packages(room.__path__, room.__name__ + "."):
            for member in vars(importlib.import_module(module.name)).values():
                mask = isinstance(member, type) and member.__module__ == module.name
                if mask and is_dataclass(member) and member.__dataclass_params__.frozen:
                    yield member


def holds_dictionary(annotation) -> bool:
    origin = typing.get_origin(annotation) or annotation
    if origin in (dict, Mapping):
        return True
    return any(holds_dictionary(part) for part in typing.get_args(annotation))


def test_every_frozen_class_with_a_dictionary_owns_it():
    """Also one that is written later."""
    checked = 0
    for cls in frozen_classes():
        names = {**vars(importlib.import_module(cls.__module__)), "dr": dr, "mi": mi}
        for entry in fields(cls):
            text = str(entry.type)  # Dr.Jit puts types in place of the text of its structures
            is_dictionary = entry.init and ("dict[" in text or "Mapping[" in text) and "Callable" not in text
            if is_dictionary and holds_dictionary(eval(text, names)):
                checked += 1
                assert issubclass(cls, FrozenMappings), f"{cls.__module__}.{cls.__name__}.{entry.name}"
    assert checked > 30
