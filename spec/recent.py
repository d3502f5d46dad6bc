"""The last few results of a computation, for programs that ask for the same again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import RLock
from typing import Generic, TypeVar

T = TypeVar("T")


class Recent(Generic[T]):
    """Results by key, of which the `most` that were asked for last are kept."""

    def __init__(self, most: int) -> None:
        self._most, self._lock = most, RLock()
        self._found: OrderedDict[Hashable, T] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """The result that was kept under `key`, else that of `make`, which is then kept. One thread at a time makes results."""
        with self._lock:
            if key not in self._found:
                self._found[key] = make()
                while len(self._found) > self._most:
                    self._found.popitem(last=False)
            self._found.move_to_end(key)
            return self._found[key]

    def __contains__(self, key: Hashable) -> bool:
        return key in self._found
