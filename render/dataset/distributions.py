"""Distributions of numbers and names in a recipe, and draws from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from cboxlab.utils.errors import InputError
from pydantic import BeforeValidator
from scipy.special import ndtr

__all__ = ["Choice", "Numbers", "Texts", "WholeNumbers", "Within", "numbers"]

#: Draws of a normal distribution after which bounds that none of them met are refused.
_MOST_DRAWS = 1000

#: Smallest probability of the bounds of a normal distribution: 1000 draws miss them once in 10^8 times.
_LEAST_CHANCE = 0.02

#: Forms of a distribution of numbers, for messages.
_FORMS = (
    "a number, [low, high] for a uniform distribution, or a table with one of uniform, log_uniform, normal (and "
    "within), integer, choice (and weights)"
)

#: Keys that may stand next to the key of a form.
_FURTHER = {"normal": {"within"}, "choice": {"weights"}}


@dataclass(frozen=True)
class Numbers:
    """Distribution of a number."""

    #: Form, such as "uniform"; "constant" for one number.
    form: str
    #: Bounds, mean and standard deviation, or the numbers to choose from.
    values: tuple[float, ...]
    #: Bounds of a normal distribution; empty for none.
    within: tuple[float, ...] = ()
    #: Weights of a choice; empty for equal ones.
    weights: tuple[float, ...] = ()

    @property
    def support(self) -> tuple[float, float]:
        """Least and greatest number that can be drawn."""
        if self.form == "normal":
            return (self.within[0], self.within[1]) if self.within else (-np.inf, np.inf)
        return min(self.values), max(self.values)

    def draw(self, generator: np.random.Generator) -> float:
        """Draw a number.

        Parameters
        ----------
        generator
            Random numbers.

        Returns
        -------
        float
            The number.

        Raises
        ------
        InputError
            If bounds of a normal distribution are met by none of many draws.
        """
        v = self.values
        if self.form == "constant":
            return v[0]
        if self.form == "uniform":
            return float(generator.uniform(v[0], v[1]))
        if self.form == "log_uniform":
            return float(np.exp(generator.uniform(*np.log(v[:2]))))
        if self.form == "integer":
            return float(generator.integers(int(v[0]), int(v[1]), endpoint=True))
        if self.form == "choice":
            return v[_index(generator, len(v), self.weights)]
        for _ in range(_MOST_DRAWS):
            number = float(generator.normal(v[0], v[1]))
            if not self.within or self.within[0] <= number <= self.within[1]:
                return number
        bounds = f"within = [{self.within[0]:g}, {self.within[1]:g}]"
        fault = f"normal = [{v[0]:g}, {v[1]:g}] with {bounds}, which none of {_MOST_DRAWS} draws met"
        raise InputError("recipe", fault, "bounds that the distribution reaches")


@dataclass(frozen=True)
class Choice:
    """Distribution of a name."""

    #: Names to choose from.
    names: tuple[str, ...]
    #: Weights; empty for equal ones.
    weights: tuple[float, ...] = ()

    def draw(self, generator: np.random.Generator) -> str:
        """Draw a name.

        Parameters
        ----------
        generator
            Random numbers.

        Returns
        -------
        str
            The name.
        """
        return self.names[_index(generator, len(self.names), self.weights)]


def _index(generator: np.random.Generator, count: int, weights: Sequence[float]) -> int:
    """Index that is drawn out of ``count``."""
    shares = np.array(weights) / np.sum(weights) if weights else None
    return int(generator.choice(count, p=shares))


def _is_number(value: object) -> bool:
    """Whether a value of a file is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _numbers_in(values: object, count: int | None) -> tuple[float, ...]:
    """Numbers of a list of ``count`` entries, or of one or more for None."""
    if not isinstance(values, list) or not values or not all(map(_is_number, values)):
        raise ValueError("a list of numbers")
    if count is not None and len(values) != count:
        raise ValueError(f"a list of {count} numbers")
    return tuple(float(value) for value in values)


def _weights(values: object, count: int) -> tuple[float, ...]:
    """Weights of a choice; empty for None."""
    if values is None:
        return ()
    weights = _numbers_in(values, count)
    if min(weights) < 0 or sum(weights) <= 0:
        raise ValueError("weights of 0 or more, one of them above 0")
    return weights


def numbers(value: object) -> Numbers:
    """Distribution of a value in a file.

    Parameters
    ----------
    value
        A number, a list of two, or a table.

    Returns
    -------
    Numbers
        The distribution.

    Raises
    ------
    ValueError
        For another value, with the expected one as text.
    """
    if isinstance(value, Numbers):
        return value
    if _is_number(value):
        return Numbers("constant", (float(value),))  # type: ignore[arg-type]
    table: dict[str, Any] = {"uniform": value} if isinstance(value, list) else value  # type: ignore[assignment]
    forms = {"uniform": 2, "log_uniform": 2, "normal": 2, "integer": 2, "choice": None}
    if not isinstance(table, dict) or len(form := [key for key in forms if key in table]) != 1:
        raise ValueError(_FORMS)
    kind = form[0]
    if set(table) - {kind} - _FURTHER.get(kind, set()):
        raise ValueError(_FORMS)
    values = _numbers_in(table[kind], forms[kind])
    within = _numbers_in(table["within"], 2) if "within" in table else ()
    weights = _weights(table.get("weights"), len(values))
    for bounds in (values if kind in ("uniform", "log_uniform", "integer") else (), within):
        if bounds and not bounds[0] <= bounds[1]:
            raise ValueError("bounds in rising order, [low, high]")
    if kind == "log_uniform" and values[0] <= 0:
        raise ValueError("bounds above 0 for log_uniform")
    if kind == "integer" and any(v != round(v) for v in values):
        raise ValueError("whole numbers for integer")
    if kind == "normal" and values[1] < 0:
        raise ValueError("a standard deviation of 0 or more")
    if within and _chance(values, within) < _LEAST_CHANCE:
        raise ValueError(f"bounds that hold at least {_LEAST_CHANCE:.0%} of the distribution")
    return Numbers(kind, values, within, weights)


def _chance(normal: Sequence[float], within: Sequence[float]) -> float:
    """Probability that a normal distribution falls within bounds."""
    mean, sigma = normal
    if sigma == 0:
        return float(within[0] <= mean <= within[1])
    low, high = ((bound - mean) / sigma for bound in within)
    return float(ndtr(high) - ndtr(low))


def _between(low: float, high: float, integral: bool = False) -> Callable[[object], Numbers]:
    """Reader of a distribution that cannot leave bounds."""

    def read(value: object) -> Numbers:
        distribution = numbers(value)
        least, most = distribution.support
        if least < low or most > high:
            bounds = f"numbers from {low:g} to {high:g}" if np.isfinite(high) else f"numbers of {low:g} or more"
            hint = " (give a normal distribution bounds: within = [low, high])" if distribution.form == "normal" else ""
            raise ValueError(bounds + hint)
        if integral and (distribution.form not in ("constant", "integer", "choice") or _fractional(distribution)):
            raise ValueError("a whole number, { integer = [low, high] } or a choice of whole numbers")
        return distribution

    return read


def _fractional(distribution: Numbers) -> bool:
    """Whether a distribution holds a number that is not whole."""
    return any(value != round(value) for value in distribution.values)


def Within(low: float, high: float = np.inf) -> Any:
    """Type of a recipe's key: a distribution of numbers within bounds.

    Parameters
    ----------
    low, high
        The bounds, which belong to them.

    Returns
    -------
    type
        An annotation for pydantic.
    """
    return Annotated[Numbers, BeforeValidator(_between(low, high))]


def WholeNumbers(low: float, high: float) -> Any:
    """Type of a recipe's key: a distribution of whole numbers within bounds.

    Parameters
    ----------
    low, high
        The bounds, which belong to them.

    Returns
    -------
    type
        An annotation for pydantic.
    """
    return Annotated[Numbers, BeforeValidator(_between(low, high, integral=True))]


def _choice(value: object) -> Choice:
    """Choice of a text, a list of texts, or a table with choice and weights."""
    if isinstance(value, Choice):
        return value
    table = value if isinstance(value, dict) else {"choice": [value] if isinstance(value, str) else value}
    names = table.get("choice")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) and name for name in names):
        raise ValueError("a name in quotes, a list of names, or { choice = [...], weights = [...] }")
    if set(table) - {"choice", "weights"}:
        raise ValueError("the keys choice and weights")
    return Choice(tuple(names), _weights(table.get("weights"), len(names)))


#: Type of a recipe's key: a distribution of names.
Texts = Annotated[Choice, BeforeValidator(_choice)]
