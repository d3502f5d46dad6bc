"""Takes the memories of a Yosys netlist (JSON) out of the logic: their pins become ports, and their bits are counted.

A memory is taken out if it has more than `limit` bits, is written, and has clocked reads; a macro generator would make it. Its
cell is removed and its pins become ports `memoryK_...` of the module. The module's area is then that of the logic around the
memory, and timing knows when the memory's pins change (`synth.timing`). Smaller memories, tables without a write port and
memories with unclocked reads stay; they become flip-flops or logic.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

from spec.constants import FLIP_FLOP_BITS

LIMIT = FLIP_FLOP_BITS
"""The limit of `take_out` where none is given, in bits."""


@dataclass(frozen=True)
class Macro:
    """The shape of a memory that is not synthesised: its words, their width in bits, and its ports."""

    words: int
    width: int
    reads: int
    writes: int

    @property
    def bits(self) -> int:
        """Size in bits."""
        return self.words * self.width


MADE_AS = ("macro", "flip-flops: small", "flip-flops: unclocked reads", "logic: never written")
"""What a memory can become."""


def take_out(module: dict, limit: int = LIMIT) -> tuple[list[Macro], list[dict[str, object]]]:
    """Remove the larger memories of one module, in place (`$mem_v2` cells, as `memory_collect` leaves them).

    Returns the removed memories, and for all memories their name, their shape and which of MADE_AS they become.
    """
    macros, stores = [], []
    for name, cell in list(module["cells"].items()):
        if cell["type"] != "$mem_v2":
            continue
        made_as = _made_as(cell, limit)
        shape = Macro(*(_number(cell, key) for key in ("SIZE", "WIDTH", "RD_PORTS", "WR_PORTS")))
        stores.append({"name": name, **asdict(shape), "made_as": made_as})
        if made_as != "macro":
            continue
        label = f"memory{len(macros)}"
        for pin in ("RD_ADDR", "RD_EN", "WR_ADDR", "WR_EN", "WR_DATA"):
            nets = list(dict.fromkeys(bit for bit in cell["connections"][pin] if isinstance(bit, int)))
            if nets:  # an enable is repeated for every bit, so duplicates are dropped
                module["ports"][f"{label}_{pin.lower()}"] = {"direction": "output", "bits": nets}
        module["ports"][f"{label}_rd_data"] = {"direction": "input", "bits": cell["connections"]["RD_DATA"]}
        macros.append(shape)
        del module["cells"][name]
    return macros, stores


def as_rows(counted: dict[Macro, int]) -> list[dict[str, int]]:
    """Shapes and their counts for a report, largest first."""
    ordered = sorted(counted.items(), key=lambda item: (-item[0].bits, item[0].width, item[0].reads, item[0].writes))
    return [{"count": count, **asdict(macro)} for macro, count in ordered]


def _made_as(cell: dict, limit: int) -> str:
    if _number(cell, "WR_PORTS") == 0:
        return "logic: never written"
    if set(cell["parameters"]["RD_CLK_ENABLE"]) != {"1"}:
        return "flip-flops: unclocked reads"
    return "macro" if _number(cell, "SIZE") * _number(cell, "WIDTH") > limit else "flip-flops: small"


def _number(cell: dict, key: str) -> int:
    return int(cell["parameters"][key], 2)
