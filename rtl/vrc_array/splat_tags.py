"""The tags of the splat cache (`rtl.cache_tags`): a record is that of a Gaussian at a tile level."""

from __future__ import annotations

from amaranth.lib import data

from rtl.cache_tags import CacheTags
from spec.config import AcceleratorConfig
from spec.queues import CACHE_WAYS
from spec.records import INDEX_BITS


def wanted_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A request for the splat record of Gaussian `index` at tile level `level`; `blend` is passed through."""
    return data.StructLayout({"index": INDEX_BITS, "level": 2, "blend": 1})


def line_bits(config: AcceleratorConfig) -> int:
    """Bits of a line's number: its way, then the low bits of the index."""
    return config.splat_cache_lines.bit_length() - 1


class SplatTags(CacheTags):
    """Decides for each splat record whether it hits or misses, and which line it uses.

    Parameters:
        config: the machine; only `splat_cache_lines` is used.

    Ports, throughput and latency: those of `CacheTags`. Storage: 512 x 74 bits for PAPER.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        super().__init__(wanted_layout(config), lines=config.splat_cache_lines, ways=CACHE_WAYS, tagged=("level",))
