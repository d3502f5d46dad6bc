"""One frame through the integer renderer, stage by stage, with the output of every stage."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from golden.host.quantise import GaussianWords, quantise_model
from golden.host.registers import FrameRegisters, frame_registers
from golden.kernels import work_clock
from golden.msv2_ref import array, projection, sort, tile_merge, tile_test
from golden.msv2_ref.buckets import Bounds, check_bounds, no_bounds
from golden.msv2_ref.chunk_test import astray
from golden.msv2_ref.colour import splat_colours
from golden.msv2_ref.regions import region_masks
from golden.msv2_ref.supertiles import Pairs, find_pairs, list_counts, merge_lists
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, FoveationMap, no_foveation
from golden.scenes.model import GaussianModel
from spec.config import DEFAULT, AcceleratorConfig
from spec.constants import COVERAGE_VALID, MAX_LEVELS, TILE
from spec.errors import InputError
from spec.records import array_splat, splat2d, tile_header

STAGES = ("gaussians", "splats", "entries", "pixels")
"""The stage outputs that a frame can dump."""


@dataclass(frozen=True)
class Frame:
    """A rendered frame and the output of every stage that led to it.

    Attributes:
        config: the machine.
        registers: what the host wrote.
        words: the DRAM image.
        projected: the projection's result, one row for each Gaussian.
        entries: the intersections of each tile, in rendering order.
        groups: (tiles,) group of each tile after merging; with super-tiles (lists,) that of each list.
        splats: every Gaussian as the array reads it; only visible ones have colours.
        pixels: finished pixels by tile, raw.
        seconds: wall time by stage.
        rendered: (tiles,) bool: which tiles were rendered; the pixels of the others are 0. None: all tiles.
        pairs: with super-tiles, the pairs of splats and super-tiles in rendering order.
        bounds: with super-tiles, the bounds of their lists.
        regions: with several streams, (E,) uint8: the streams that have each of the intersections, one bit each.
    """

    config: AcceleratorConfig
    registers: FrameRegisters
    words: GaussianWords
    projected: projection.Projected
    entries: tile_test.Intersections
    groups: np.ndarray
    splats: array.ArraySplats
    pixels: array.Pixels
    seconds: dict[str, float] = field(default_factory=dict)
    rendered: np.ndarray | None = None
    pairs: Pairs | None = None
    bounds: Bounds | None = None
    regions: np.ndarray | None = None

    def untiled(self, tiled: np.ndarray) -> np.ndarray:
        """A field of `pixels`, which is stored by tile, as (height, width, ...)."""
        r = self.registers
        grid = tiled.reshape(r.tiles_y, r.tiles_x, TILE, TILE, *tiled.shape[3:]).swapaxes(1, 2)
        return grid.reshape(r.tiles_y * TILE, r.tiles_x * TILE, *tiled.shape[3:])[: r.height, : r.width]

    @property
    def image(self) -> np.ndarray:
        """(height, width, 3) float64 colour before clamping and 8-bit rounding."""
        return self.config.formats.accumulator.to_float(self.untiled(self.pixels.colour))

    @property
    def transmittance(self) -> np.ndarray:
        """(height, width) float64, the background's weight in each pixel."""
        return self.config.formats.transmittance.to_float(self.untiled(self.pixels.transmittance))

    @property
    def depth(self) -> np.ndarray:
        """(height, width) float64 z in world units, NaN where the coverage is below one half."""
        n, r, weight = self.config.formats, self.registers, self.config.depth_weight
        drop = n.transmittance.frac_bits - weight.frac_bits
        weights = (n.transmittance.raw_max >> drop) - (self.untiled(self.pixels.transmittance) >> drop)  # sum of the weights
        total = n.depth_accumulator.to_float(self.untiled(self.pixels.depth)) * r.depth_far
        mean = total / weight.to_float(np.maximum(weights, 1))
        return np.where(1 - self.transmittance >= COVERAGE_VALID, mean, np.nan)

    @property
    def headers(self) -> np.ndarray:
        """(tiles,) TileHeader records of the rendered tiles, row-major."""
        r = self.registers
        headers = np.zeros(len(r.header), tile_header(self.config).dtype)
        headers["tile_y"], headers["tile_x"] = np.divmod(np.arange(len(headers)), r.tiles_x)
        headers["blend"], headers["outer"], headers["plane"] = r.header[:, 1], r.header[:, 2], r.plane
        headers["count"] = np.diff(self.entries.start)
        return headers if self.rendered is None else headers[self.rendered]

    @property
    def array_entries(self) -> np.ndarray:
        """(entries,) ArraySplat records in rendering order."""
        e, s = self.entries, self.splats
        rows = e.splat
        level = np.repeat(self.registers.header[:, 0], np.diff(e.start))
        both = np.minimum(np.stack([level, level + 1], 1), s.log2_opacity.shape[1] - 1)
        out = np.zeros(len(rows), array_splat(self.config).dtype)
        out["mean2d"], out["depth"] = s.mean2d[rows], s.depth[rows]
        out["conic"] = self.config.formats.conic.quantise(self.projected.conic[rows])
        out["use"] = e.use[:, None] >> np.arange(2) & 1
        out["log2_opacity"] = s.log2_opacity[rows[:, None], both]
        out["colour"] = s.colour[rows[:, None], both].reshape(-1, 6)
        return out

    @property
    def read(self) -> np.ndarray:
        """(N,) bool: the Gaussians that the machine reads; where the chunk test skips a chunk, it reads none of it."""
        return self.projected.reason != projection.UNREAD

    @property
    def chunks_read(self) -> int:
        """The number of chunks whose Gaussians are read; 0 in a machine without chunks."""
        chunks = self.words.chunks
        if chunks is None:
            return 0
        there = (chunks["count"] > 0) & ~astray(chunks, len(self.read))
        return int(self.read[chunks["first"][there]].sum())

    @property
    def chunks_skipped(self) -> int:
        """The number of chunks that the chunk test skips; 0 in a machine without chunks."""
        return 0 if self.words.chunks is None else len(self.words.chunks) - self.chunks_read

    @property
    def splats2d(self) -> np.ndarray:
        """(visible,) Splat2D records in index order."""
        p, rows = self.projected, np.flatnonzero(self.projected.reason == projection.VISIBLE)
        level = np.minimum(np.arange(MAX_LEVELS), self.splats.colour.shape[1] - 1)
        out = np.zeros(len(rows), splat2d(self.config).dtype)
        out["index"], out["bound"] = rows, self.words.geometry["bound"][rows]
        out["mean2d"], out["depth"], out["depth_key"] = p.mean2d[rows], p.depth[rows], p.depth_key[rows]
        out["conic"] = self.config.formats.conic.quantise(p.conic[rows])
        out["log2_opacity"] = self.words.geometry["log2_opacity"][rows]
        out["colour"] = self.splats.colour[rows][:, level].reshape(len(rows), -1)
        return out

    def _gaussians(self) -> dict[str, np.ndarray]:
        words = self.words
        more = {"model_index": words.model_index, "chunks": words.chunks}
        return {"geometry": words.geometry, "colour": words.colour, "origin": words.origin,
                **{name: rows for name, rows in more.items() if rows is not None}}

    def stage(self, name: str) -> dict[str, np.ndarray]:
        """The output of the named stage (one of STAGES) as arrays for `numpy.savez`."""
        arrows = {
            "gaussians": self._gaussians,
            "splats": lambda: {"splats": self.splats2d, "reason": self.projected.reason},
            "entries": lambda: {"headers": self.headers, "entries": self.array_entries, "group": self.groups,
                                "index": self.entries.splat, "background": self.registers.background},
            "pixels": lambda: self.pixels._asdict(),
        }
        return arrows[name]()


def _check_size(config: AcceleratorConfig, camera: Camera) -> None:
    if not (1 <= camera.width <= config.row_width and 1 <= camera.height <= config.row_width):
        size = f"{camera.width}x{camera.height}"
        raise InputError(f"frame size {size} is not accepted: config {config.name!r} takes 1..{config.row_width} pixels")


def check_request(config: AcceleratorConfig, words: GaussianWords, camera: Camera, foveation: FoveationMap | None) -> None:
    """Raises InputError where the frame is larger than the machine's rows, or more levels are asked for than machine and model
    have."""
    _check_size(config, camera)
    supported = min(config.levels, words.levels)
    if foveation is not None and foveation.levels > supported:
        raise InputError(
            f"{foveation.levels} levels are not accepted: config {config.name!r} and the model support {supported}")


def render(
    model: GaussianModel | GaussianWords, camera: Camera, *, config: AcceleratorConfig = DEFAULT,
    foveation: FoveationMap | None = None, background: tuple[float, float, float] = (0.0, 0.0, 0.0), beta: int | None = None,
    obb: bool = False, baseline_px: float | None = None, bounds: Bounds | None = None,
) -> Frame:
    """Renders one frame with the integer renderer.

    Args:
        model: the Gaussians, or their words when several frames share them.
        camera: the camera; its frame may be at most `config.row_width` wide and high.
        config: the machine.
        foveation: tile levels and blend planes; None renders level 1 everywhere.
        background: red, green, blue in [0, 1].
        beta: tile merge threshold; None chooses it from the tiles' counts.
        obb: test tiles against bounding boxes instead of the exact ellipse.
        baseline_px: for a frame that is to be warped, see `golden.host.registers.frame_registers`; only the depth scale
            depends on it.
        bounds: with super-tiles, the bounds that the frame before left (`golden.msv2_ref.buckets`); None: none.

    Raises:
        InputError: the frame is larger than the machine's rows, or more levels are asked for than machine and model have.
    """
    _check_size(config, camera)
    seconds, clock = {}, work_clock

    begin = clock()
    words = model if isinstance(model, GaussianWords) else quantise_model(config, model)
    check_request(config, words, camera, foveation)
    foveation = foveation or no_foveation(Display(camera.width, camera.height))
    seconds["quantise"] = clock() - begin

    begin = clock()
    registers = frame_registers(config, camera, words, foveation, background, baseline_px)
    seconds["culling"] = clock() - begin
    return render_frame(config, words, registers, beta=beta, obb=obb, seconds=seconds, bounds=bounds)


def render_frame(
    config: AcceleratorConfig, words: GaussianWords, registers: FrameRegisters, *, beta: int | None = None, obb: bool = False,
    rendered: np.ndarray | None = None, seconds: dict[str, float] | None = None, bounds: Bounds | None = None,
) -> Frame:
    """The machine's part of rendering a frame, after the host has written the registers.

    Args:
        config: the machine.
        words: the DRAM image.
        registers: what the host wrote.
        beta, obb: see `render`.
        rendered: (tiles,) bool: tiles to render; None renders all.
        seconds: wall time of the stages before this; the times of this function's stages are added.
        bounds: see `render`.
    """
    seconds, clock = {} if seconds is None else seconds, work_clock
    begin = clock()
    projected = projection.project(config, words, registers, rendered)
    seconds["culling"] = seconds.get("culling", 0.0) + clock() - begin

    begin = clock()
    order = sort.depth_order(projected.depth_key, projected.reason == projection.VISIBLE)
    seconds["sort"] = clock() - begin

    begin = clock()
    entries, regions = found_intersections(config, words, registers, projected, order, obb=obb, rendered=rendered)
    counts, pairs = np.diff(entries.start), None
    if config.supertiles:
        pairs = find_pairs(registers, words.chunks, projected.depth_key, entries)
        bounds = bounds or no_bounds(len(pairs.start) - 1)
        check_bounds(config, bounds, len(pairs.start) - 1)
        groups = merge_lists(config, list_counts(pairs, bounds), beta)
    else:
        groups = tile_merge.merge_tiles(
            counts, registers.tiles_x, tile_merge.auto_beta(counts, config) if beta is None else beta)
    seconds["tiles"] = clock() - begin

    begin = clock()
    splats = array_splats(config, words, registers, projected, order)
    seconds["colour"] = clock() - begin

    begin = clock()
    pixels = array_pixels(config, registers, splats, entries, rendered)
    seconds["array"] = clock() - begin
    return Frame(
        config, registers, words, projected, entries, groups, splats, pixels, seconds, rendered, pairs, bounds, regions)


def found_intersections(
    config: AcceleratorConfig, words: GaussianWords, registers: FrameRegisters, projected: projection.Projected,
    order: np.ndarray, *, obb: bool, rendered: np.ndarray | None,
) -> tuple[tile_test.Intersections, np.ndarray | None]:
    """The intersections of a frame, and with several streams the streams that have each of them (`Frame.regions`).

    Args:
        config, words, registers, obb, rendered: see `render_frame`.
        projected: the projection's result.
        order: (visible,) int32 rows of the visible splats in rendering order.
    """
    tested = tile_test.tested_opacity(config, words.geometry["log2_opacity"], words.decoded.opacity)
    entries = tile_test.tile_intersections(
        config, projected, tested, words.geometry["bound"], registers, order, obb=obb, rendered=rendered)
    if config.streams == 1:
        return entries, None
    return entries, region_masks(config, projected, tested, registers, entries, obb=obb)


def array_splats(
    config: AcceleratorConfig, words: GaussianWords, registers: FrameRegisters, projected: projection.Projected,
    order: np.ndarray,
) -> array.ArraySplats:
    """All splats as the array reads them, with colours of the splats `order` for the camera of `registers`; the arguments are
    as in `found_intersections`."""
    colour = np.zeros((len(words.geometry), words.levels, 3), np.int32)
    colour[order] = splat_colours(config, words, registers, order)
    significand, exponent = array.split_conic(config, projected.conic)
    opacity = words.geometry["log2_opacity"][:, : words.levels].astype(np.int32)
    return array.ArraySplats(projected.mean2d, significand, exponent, opacity, colour, projected.depth)


def array_pixels(
    config: AcceleratorConfig, registers: FrameRegisters, splats: array.ArraySplats, entries: tile_test.Intersections,
    rendered: np.ndarray | None = None,
) -> array.Pixels:
    """The pixels of a frame, from its splats and intersections; `rendered` is as in `render_frame`."""
    tile_y, tile_x = np.divmod(np.arange(len(registers.header)), registers.tiles_x)
    header = np.ascontiguousarray(np.column_stack([tile_x, tile_y, registers.header[:, [0, 2, 1]]]))
    work = array.TileWork(header, registers.plane, entries.start, entries.splat, entries.use)
    return array.render(config, splats, work, registers.background, rendered)
