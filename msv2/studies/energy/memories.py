"""The memories of a unit in another machine than the one that was measured: the same accesses, to memories of other shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from msv2.studies.area.stores import Store, stores
from msv2.studies.energy.table import Memory, Unit
from spec.config import PAPER, V3, V3_STREAMS, AcceleratorConfig

STREAMED = {"stream_buffer": "batch_buffer"}
"""Units that were measured with several streams, and the name of their memories, which is that of the unit with one."""


def configured(unit: Unit, config: AcceleratorConfig) -> tuple[Memory, ...]:
    """The memories of a unit in `config`, with the accesses of an operation.

    The table of energies was measured on PAPER, and units that only machines with lists by super-tile have on V3. A
    memory that has the same shape there and in `config` stays as it was
    measured; another one has the shape that `config` gives it (`msv2.studies.area.stores`). Where a machine has more or fewer
    equal memories, such as lanes, they share the accesses. A stage that only a longer sorter has is accessed as the measured
    last one.
    """
    measured = V3_STREAMS if unit.name in STREAMED else V3
    was = _of(unit, PAPER.with_(stereo=config.stereo)) or (_of(unit, measured) if config.supertiles else [])
    now = {store.name: store for store in _of(unit, config)}
    places, out = _places(unit.memories, was), []
    for number, memory in enumerate(unit.memories):
        store = places.get(number)
        if store is None or now.get(store.name) == store:
            out.append(memory)
    for store in was:
        measured = [unit.memories[number] for number, other in places.items() if other is store]
        here = now.get(store.name)
        if measured and here is not None and here != store:
            out += _shared(measured, here)
    known = {store.name for store in was}
    longest = [unit.memories[number] for number, store in places.items() if store.name.startswith("stage")]
    for name, store in now.items():
        if name not in known and name.startswith("stage") and longest:
            out.append(replace(max(longest, key=lambda memory: memory.words), words=store.words, width=store.width))
    return tuple(out)


def _of(unit: Unit, config: AcceleratorConfig) -> list[Store]:
    return [store for store in stores(config) if store.unit == STREAMED.get(unit.name, unit.name)]


def _shared(measured: Sequence[Memory], here: Store) -> list[Memory]:
    """As many memories as the machine has, which share the accesses of those that were measured."""
    reads, writes = (sum(getattr(memory, name) for memory in measured) / here.count for name in ("reads", "writes"))
    return [Memory(here.words, here.width, reads, writes)] * here.count


def _places(memories: Sequence[Memory], was: Sequence[Store]) -> dict[int, Store]:
    """For the number of each measured memory the store that it is: by its shape, else by its width or its words alone, because
    some memories have grown since they were measured."""
    left = {store.name: store.count for store in was}
    found: dict[int, Store] = {}
    for same in (lambda m, s: (m.words, m.width) == (s.words, s.width), lambda m, s: m.width == s.width,
                 lambda m, s: m.words == s.words):
        for number, memory in enumerate(memories):
            store = next((s for s in was if left[s.name] and same(memory, s)), None) if number not in found else None
            if store is not None:
                found[number] = store
                left[store.name] -= 1
    return found
