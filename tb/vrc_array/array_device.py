"""The rendering array with files at its streams, and the conversion of its pixel rows to tiles."""

from __future__ import annotations

from functools import cache

import numpy as np

from golden.msv2_ref.array import Pixels
from spec.config import AcceleratorConfig
from spec.queues import COUNTER_BITS
from spec.records import array_splat, pixel_row, tile_header
from tb.common.emission import emitted
from tb.common.playback import Playback, Stream


@cache
def vrc_playback(config: AcceleratorConfig) -> Playback:
    """The array of a configuration, emitted as Verilog, with a file at each stream."""
    return Playback(
        name=f"vrc-{config.cores_x}x{config.cores_y}", module="vrc_array", verilog=emitted("vrc_array", config),
        inputs=(Stream("tiles", tile_header(config)), Stream("entries", array_splat(config))),
        outputs=(Stream("pixels", pixel_row(config)),), settings=(("background", 3 * config.formats.colour.width),),
        observed=(*((name, COUNTER_BITS) for name in ("ops", "skipped", "waits")), ("busy", 1)), apart=("pixel_core",))


def background_bits(config: AcceleratorConfig, background: np.ndarray) -> int:
    """The value of the array's `background` port, with red in the lowest bits."""
    width = config.formats.colour.width
    return sum(int(value) << (width * channel) for channel, value in enumerate(background))


def rows_per_tile(config: AcceleratorConfig) -> int:
    """Number of PixelRow items of one tile, or of a stream's quarter of it."""
    return config.region**2 // config.array_x


def tiles_from_rows(config: AcceleratorConfig, headers: np.ndarray, rows: np.ndarray, quarter: int = 0) -> Pixels:
    """Pixels by tile, from the array's rows in the order in which they came. Within a tile any order is accepted.
    The array of a stream has the pixels of a quarter of each tile, here the one with this number.

    Raises:
        ValueError: the rows are not those of the headers' tiles, in the order of the headers, each exactly once.
    """
    each, lanes = rows_per_tile(config), config.array_x
    if len(rows) != each * len(headers):
        raise ValueError(f"{len(headers)} tiles must give {each * len(headers)} rows, not {len(rows)!r}")
    tile = np.repeat(np.arange(len(headers)), each)
    for name in ("tile_x", "tile_y"):
        wrong = np.flatnonzero(rows[name] != headers[name][tile])
        if len(wrong):
            raise ValueError(f"row {wrong[0]} must have {name} {headers[name][tile[wrong[0]]]}, not {rows[name][wrong[0]]!r}")
    side, (top, left) = config.region, divmod(quarter, config.split)
    row, column = rows["row"] - top * side, rows["column"] - left * side
    if ((row < 0) | (row >= side) | (column < 0) | (column >= side)).any():
        raise ValueError(f"every row must lie in quarter {quarter}")
    place = (tile * side + row) * (side // lanes) + column // lanes
    if (rows["column"] % lanes).any() or len(np.unique(place)) != len(place):
        raise ValueError("every row of a tile must come once")
    order = np.argsort(place)

    def by_tile(values: np.ndarray, channels: int) -> np.ndarray:
        return values[order].astype(np.int64).reshape(len(headers), side, side, channels)

    return Pixels(
        by_tile(rows["colour"], 3), by_tile(rows["depth"], 1)[..., 0], by_tile(rows["transmittance"], 1)[..., 0])
