"""Faults of files are stated in the program's words, not in those of the library that checks them."""

from typing import Annotated, Literal

import pytest
from cboxlab.utils.faults import faults_of_validation
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError("an odd number")
    return value


class Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    above: float = Field(1.0, gt=0)
    least: float = Field(1.0, ge=0)
    below: float = Field(0.0, lt=1)
    most: float = Field(0.0, le=1)
    integer: int = 0
    text: str = Field("aa", min_length=2, max_length=4, pattern="^a")
    kind: Literal["box", "sphere"] = "box"
    flag: bool = False
    numbers: list[float] = Field([1.0], min_length=1, max_length=2)
    table: dict[str, float] = Field(default_factory=dict)
    odd: Annotated[int, AfterValidator(_odd)] = 1
    nested: "Table | None" = None


FAULTS = (
    ("above", 0.0, "above 0"),
    ("above", "4_00", "a number"),
    ("least", -1, "0.0 or more"),
    ("below", 1, "below 1"),
    ("most", 2, "1.0 or less"),
    ("most", float("nan"), "finite"),
    ("integer", 1.5, "whole"),
    ("integer", "4_00", "whole"),
    ("text", 5, "in quotes"),
    ("text", "a", "at least 2 characters"),
    ("text", "aaaaa", "at most 4 characters"),
    ("text", "bb", "pattern ^a"),
    ("kind", "cone", "'box' or 'sphere'"),
    ("flag", 1, "true or false"),
    ("numbers", 3, "numbers = [...]"),
    ("numbers", [], "at least 1"),
    ("numbers", [1, 2, 3], "at most 2"),
    ("table", [1], "[table]"),
    ("odd", 2, "an odd number"),
    ("nested", 3, "[nested]"),
)


@pytest.mark.parametrize(("key", "value", "expected"), FAULTS, ids=str)
def test_an_expectation_is_in_plain_words(tmp_path, key, value, expected):
    with pytest.raises(ValidationError) as fault:
        Table.model_validate({key: value})
    (error,) = faults_of_validation(tmp_path / "file.toml", fault.value, Table)
    assert expected in error.expected
    for phrase in ("Input", "should", "valid", "instance", "dictionary", "parse", "documentation"):
        assert phrase not in error.expected
