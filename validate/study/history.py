"""The states of a study, one after the other, with a place among them: undo and redo are moves of the place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from cboxlab.rendering.effects import AppliedEffect

__all__ = ["History", "State"]


@dataclass(frozen=True, eq=False)
class State:
    """effects : of the model, in order. rendered_with : the effects that the picture was last rendered with; from
    there to ``effects`` the predictor leads."""

    effects: tuple[AppliedEffect, ...]
    rendered_with: tuple[AppliedEffect, ...]


@dataclass(frozen=True, eq=False)
class History:
    """states : at least one. at : the index of the present one."""

    states: tuple[State, ...]
    at: int = 0

    @property
    def present(self) -> State:
        """The state in force."""
        return self.states[self.at]

    @property
    def can_undo(self) -> bool:
        """Whether a state is before the present one."""
        return self.at > 0

    @property
    def can_redo(self) -> bool:
        """Whether an undone state is after the present one."""
        return self.at + 1 < len(self.states)

    def then(self, effects: Sequence[AppliedEffect]) -> History:
        """With other effects from here on; undone states are dropped."""
        state = State(tuple(effects), self.present.rendered_with)
        return History((*self.states[: self.at + 1], state), self.at + 1)

    def rendered(self) -> History:
        """With the present state's picture rendered with its own effects."""
        state = State(self.present.effects, self.present.effects)
        return replace(self, states=(*self.states[: self.at], state, *self.states[self.at + 1 :]))

    def undone(self) -> History:
        """One state back; the first stays."""
        return replace(self, at=max(self.at - 1, 0))

    def redone(self) -> History:
        """One undone state forward; the last stays."""
        return replace(self, at=min(self.at + 1, len(self.states) - 1))
