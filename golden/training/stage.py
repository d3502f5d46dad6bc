"""A stage of training: the interface that lets the chain run, log, checkpoint and resume it."""

from __future__ import annotations

from abc import ABC, abstractmethod


class Stage(ABC):
    """One stage, from the result of the stage before to its own result.

    A stage is deterministic: whatever is drawn at random comes from a generator that is seeded by the seed, the stage's name
    and counters that are part of `state`. So a stage loaded from a checkpoint continues exactly as if it had never been
    interrupted.

    Attributes:
        name: a short name, unique in a chain, for file names and logs.
        total: number of iterations that it is expected to take.
        done: number of iterations taken.
    """

    name: str
    total: int
    done: int

    @property
    def finished(self) -> bool:
        """Whether `result` is final."""
        return self.done >= self.total

    @abstractmethod
    def step(self) -> dict[str, float]:
        """Takes one iteration.

        Returns:
            What is logged of it: at least `loss` and `points`; where measured, `psnr` and others.
        """

    @abstractmethod
    def state(self) -> dict[str, object]:
        """Everything that `load` needs: tensors, arrays and plain values, for `torch.save`."""

    @abstractmethod
    def load(self, state: dict[str, object]) -> None:
        """Restores the stage as it was when `state` was taken."""

    @abstractmethod
    def result(self) -> object:
        """The result of the stage, from which the next stage starts."""
