"""A stage of training: what the chain runs, logs, checkpoints and resumes."""

from __future__ import annotations

from abc import ABC, abstractmethod


class Stage(ABC):
    """One stage, from what the stage before left to a result.

    A stage is deterministic: whatever is drawn at random comes from a generator seeded by the seed, the stage's name and
    counters that are part of `state`, so that a stage loaded from a checkpoint goes on exactly as if never interrupted.

    Attributes:
        name: short and unique in a chain, in file names and logs.
        total: iterations it is expected to take.
        done: iterations taken.
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
        """One iteration: what there is to log of it, at least `loss` and `points`; where measured, `psnr` and others."""

    @abstractmethod
    def state(self) -> dict[str, object]:
        """Everything `load` needs, tensors, arrays and plain values, for `torch.save`."""

    @abstractmethod
    def load(self, state: dict[str, object]) -> None:
        """Goes back to where `state` was taken."""

    @abstractmethod
    def result(self) -> object:
        """What the stage made; the next stage starts from it."""
