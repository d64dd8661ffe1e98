"""States of a study in order, with a present one among them: undo and redo move it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from cboxlab.rendering.effects import AppliedEffect

__all__ = ["History", "State"]


@dataclass(frozen=True, eq=False)
class State:
    """One state of a study."""

    #: Effects of the model, in order.
    effects: tuple[AppliedEffect, ...]
    #: Effects with which the picture was last rendered; the predictor leads from there to `effects`.
    rendered_with: tuple[AppliedEffect, ...]


@dataclass(frozen=True, eq=False)
class History:
    """States of a study in order; the first is never dropped."""

    #: At least one state.
    states: tuple[State, ...]
    #: Index of the present one.
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
        """The history with other effects from here on; undone states are dropped.

        Parameters
        ----------
        effects
            Effects of the new present state.

        Returns
        -------
        History
            With one state more than up to the present one.
        """
        state = State(tuple(effects), self.present.rendered_with)
        return History((*self.states[: self.at + 1], state), self.at + 1)

    def rendered(self) -> History:
        """The history with the present state's picture rendered with all its effects.

        Returns
        -------
        History
            With as many states.
        """
        state = State(self.present.effects, self.present.effects)
        return replace(self, states=(*self.states[: self.at], state, *self.states[self.at + 1 :]))

    def undone(self) -> History:
        """The history one state back; the first stays.

        Returns
        -------
        History
            With another present state.
        """
        return replace(self, at=max(self.at - 1, 0))

    def redone(self) -> History:
        """The history one undone state forward; the last stays.

        Returns
        -------
        History
            With another present state.
        """
        return replace(self, at=min(self.at + 1, len(self.states) - 1))
