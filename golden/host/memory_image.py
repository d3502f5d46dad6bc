"""The host's side of a frame's memory: where each region lies, what it holds at the start, and how to read the frame at the
end.

A frame needs the Gaussians (`golden.host.quantise`) and what the host computes for the camera (`golden.host.registers`). Both
become bytes in memory and raw values of the settings in `spec.memory.frame_settings`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from golden.host.joint_registers import JointRegisters, JointWarping
from golden.host.packed_frame import unpack_blocks
from golden.host.quantise import GaussianWords
from golden.host.registers import FrameRegisters
from golden.host.stereo_registers import StereoRegisters
from spec.chunks import chunk_header
from spec.config import AcceleratorConfig
from spec.constants import SUPER_TILES, SUPER_X, SUPER_Y
from spec.effects import with_joint_frames, with_packed_frames, with_two_eyes
from spec.formats import SmallFloat
from spec.joint import grid_origins, joint_columns
from spec.joint_warp import check_joint_warp
from spec.memory import (
    BEAT_BYTES,
    BEAT_ENTRIES,
    DIRECTORY_BEATS,
    DISPLAY_PIXEL_BYTES,
    PIXEL_BYTES,
    TILE_SETTING_BYTES,
    colour_beats,
    display_pixel,
    frame_pixel,
    frame_settings,
    tile_setting,
)
from spec.packed import packed_beats
from spec.packing import pack
from spec.records import frame_lists, gaussian_colour, gaussian_geometry

REGIONS = (
    "chunks", "geometry", "colour", "tiles", "supertiles", "target_tiles", "views", "directory", "entries", "spill", "frame",
    "target_frame")
"""The regions in the order in which they lie in memory. The host fills those before `views` (the splat records), and the
machine writes `views` and those after it. Only machines with chunks have their region, only those with super-tiles have
`supertiles` and have no `views`, and a frame of one eye has no region of the target's."""

_SECOND_EYE = (
    "source_right", "target_position", "disparity_scale", "target_tiles_base", "target_frame_base", "shift", "shared_colour",
    "second_sweep")
"""Settings that a frame of one eye ignores."""

_WARPING = ("source_right", "disparity_scale", "second_sweep")
"""Those of them that a joint frame without warping ignores, too."""

_SUPERTILE_BEATS = SUPER_TILES * TILE_SETTING_BYTES // BEAT_BYTES
_FIRST_BEAT, _GUARD_BEATS = 3, 5  # no region starts at 0 or at a round number, so that a forgotten base changes the frame


class Region(NamedTuple):
    """A contiguous region of memory: its first beat and its length in beats of BEAT_BYTES."""

    base: int
    beats: int

    @property
    def end(self) -> int:
        """The first beat after the region."""
        return self.base + self.beats


class FramePixels(NamedTuple):
    """A frame as raw numbers from memory: `colour` (height, width, 3), `depth` and `transmittance` (height, width), int64."""

    colour: np.ndarray
    depth: np.ndarray
    transmittance: np.ndarray


class DisplayPixels(NamedTuple):
    """A frame in the format for displays, as raw numbers from memory: `colour` (height, width, 3), `coverage` (height,
    width), int64."""

    colour: np.ndarray
    coverage: np.ndarray


class PackedPixels(NamedTuple):
    """A packed frame from memory: `colour` and `coverage` as in DisplayPixels, `data` (beats, BEAT_BYTES) uint8, the region as
    it is, and `errors` (blocks,) int64, a PackedError code for each block. The pixels of damaged blocks have no meaning."""

    colour: np.ndarray
    coverage: np.ndarray
    data: np.ndarray
    errors: np.ndarray


@dataclass(frozen=True)
class MemoryImage:
    """What the host puts into memory and registers for one frame.

    Attributes:
        config: the machine.
        width, height: size of the frame in pixels.
        regions: by the names in REGIONS.
        settings: raw values of `frame_settings` by field; a list where the field holds several numbers.
        contents: for each region that the host fills, its content as (beats, BEAT_BYTES) uint8.
    """

    config: AcceleratorConfig
    width: int
    height: int
    regions: dict[str, Region]
    settings: dict[str, int | list[int]]
    contents: dict[str, np.ndarray]

    @property
    def beats(self) -> int:
        """Number of beats that the memory must have."""
        return max(region.end for region in self.regions.values())

    @property
    def first_writable(self) -> int:
        """The first beat that the machine may write."""
        return self.regions["directory" if self.config.supertiles else "views"].base

    @property
    def pixel_bytes(self) -> int:
        """Number of bytes of one pixel of the frame; 0 where the frame is packed."""
        if self.packed:
            return 0
        return DISPLAY_PIXEL_BYTES if self.settings["display"] else PIXEL_BYTES

    @property
    def packed(self) -> bool:
        """Whether the frame is packed."""
        return bool(self.settings.get("packed", 0))

    def write(self, name: str, path: Path) -> None:
        """Writes the contents of a region to a file in the order that Verilog's `$fread` expects: the highest byte of a beat
        first."""
        np.ascontiguousarray(self.contents[name][:, ::-1]).tofile(path)

    def frame(self, path: Path) -> FramePixels | DisplayPixels | PackedPixels:
        """Reads the frame from a dump of the region `frames`; of a frame of two eyes, it reads the source eye's."""
        return self._read(path, 0)

    def target_frame(self, path: Path) -> FramePixels | DisplayPixels | PackedPixels | None:
        """Reads the target eye's frame from the same dump; returns None for a frame of one eye."""
        if "target_frame" not in self.regions:
            return None
        return self._read(path, self.regions["target_frame"].base - self.frames.base)

    def _read(self, path: Path, beat: int) -> FramePixels | DisplayPixels | PackedPixels:
        """Reads the frame that begins at a beat of a dump."""
        data = np.fromfile(path, np.uint8)[BEAT_BYTES * beat :]
        if self.packed:
            return read_packed(data, self.width, self.height)
        return read_frame(self.config, data, self.width, self.height, display=bool(self.settings["display"]))

    @property
    def frames(self) -> Region:
        """The region that holds the pixels of all eyes at the end."""
        first = self.regions["frame"]
        return Region(first.base, self.regions.get("target_frame", first).end - first.base)


def lay_out(beats: Mapping[str, int]) -> dict[str, Region]:
    """The regions of a memory, from their lengths in beats by the names in REGIONS."""
    regions, base = {}, _FIRST_BEAT
    for name in (name for name in REGIONS if name in beats):
        regions[name] = Region(base, beats[name])
        base += beats[name] + _GUARD_BEATS
    return regions


def view_shift(*registers: FrameRegisters) -> int:
    """The smallest setting `view_shift` that leaves a splat record for every level in use, in every one of the eyes."""
    return max(int(eye.header[:, 0].max()).bit_length() for eye in registers)


def gaussian_bytes(config: AcceleratorConfig, words: GaussianWords) -> dict[str, np.ndarray]:
    """The regions `geometry`, `colour` and, for machines with chunks, `chunks`, (beats, BEAT_BYTES) uint8 each; they are the
    same for all frames of a model."""
    out = {} if words.chunks is None else {"chunks": pack(chunk_header(config), words.chunks, BEAT_BYTES)}
    if words.compact is not None:
        return out | {"geometry": words.compact.geometry_bytes(), "colour": words.compact.colour_bytes()}
    size = BEAT_BYTES * colour_beats(config, words.sh_degree)
    colour = pack(gaussian_colour(config, words.sh_degree), words.colour, size)
    return out | {
        "geometry": pack(gaussian_geometry(config), words.geometry, BEAT_BYTES), "colour": colour.reshape(-1, BEAT_BYTES)}


def tile_bytes(config: AcceleratorConfig, registers: FrameRegisters, warp: np.ndarray | None = None) -> np.ndarray:
    """A table of tiles, (beats, BEAT_BYTES) uint8; `warp` holds the bit of that name for each tile of the target eye."""
    rows = {"plane": registers.plane, "level": registers.header[:, 0], "blend": registers.header[:, 1]}
    if config.stereo:
        rows["warp"] = np.zeros(len(registers.header), np.int64) if warp is None else warp
    flat = pack(tile_setting(config), rows, TILE_SETTING_BYTES).reshape(-1)
    return np.pad(flat, (0, -len(flat) % BEAT_BYTES)).reshape(-1, BEAT_BYTES)


def supertile_bytes(
    config: AcceleratorConfig, registers: FrameRegisters, *, origin: int = 0, columns: int | None = None,
    warp: np.ndarray | None = None,
) -> np.ndarray:
    """The settings of the tiles of each super-tile, (super-tiles * SUPER_TILES * TILE_SETTING_BYTES / BEAT_BYTES, BEAT_BYTES)
    uint8: the same as in the table of tiles, and 0 for tiles beyond the frame. With `columns` columns of super-tiles, the frame
    begins `origin` columns of tiles right of the first one's left edge. `warp` is as in `tile_bytes`."""
    columns, rows = columns or -(-registers.tiles_x // SUPER_X), -(-registers.tiles_y // SUPER_Y)
    tiles = tile_bytes(config, registers, warp).reshape(-1, TILE_SETTING_BYTES)[: len(registers.header)]
    grid = np.zeros((rows * SUPER_Y, columns * SUPER_X, TILE_SETTING_BYTES), np.uint8)
    grid[: registers.tiles_y, origin : origin + registers.tiles_x] = tiles.reshape(
        registers.tiles_y, registers.tiles_x, TILE_SETTING_BYTES)
    return grid.reshape(rows, SUPER_Y, columns, SUPER_X, TILE_SETTING_BYTES).swapaxes(1, 2).reshape(-1, BEAT_BYTES)


def joint_supertile_bytes(config: AcceleratorConfig, joint: JointRegisters) -> np.ndarray:
    """The same of a joint frame: the beats of each super-tile's source, and behind them those of its target."""
    columns = joint_columns(joint.source.tiles_x, joint.shift)
    warps = None, joint.warping and joint.warping.warp
    eyes = [supertile_bytes(config, eye, origin=origin, columns=columns, warp=warp).reshape(-1, _SUPERTILE_BEATS, BEAT_BYTES)
            for eye, origin, warp in zip(joint.eyes, grid_origins(joint.shift), warps, strict=True)]
    return np.stack(eyes, 1).reshape(-1, BEAT_BYTES)


def memory_image(
    config: AcceleratorConfig, words: GaussianWords, registers: FrameRegisters, *, entries_beats: int, spill_beats: int,
    beta: int | None = None, obb: bool = False, display: bool = False, packed: bool = False,
    gaussians: Mapping[str, np.ndarray] | None = None, second: StereoRegisters | JointRegisters | None = None,
) -> MemoryImage:
    """Lays out the memory of a frame.

    Args:
        config: the machine.
        words: the Gaussians.
        registers: camera and frame registers; for two eyes, the source's.
        entries_beats: beats reserved for the lists of tiles or super-tiles; `page_beats` says how many a frame needs.
        spill_beats: beats reserved for spilled sorted runs; see `spill_beats`.
        beta: merge threshold; 0 merges nothing, and None lets the machine choose it.
        obb: test tiles against bounding boxes instead of the exact ellipse.
        display: write the frame in the format for displays.
        packed: pack the frame, in joint frames that of either eye (`spec.packed`); it then has the format for displays.
        gaussians: `gaussian_bytes` of the words, where several frames share them.
        second: registers of the target eye, for a frame of two eyes; where it is warped, the frame always has the format for
            displays. JointRegisters are those of both eyes of a joint frame.

    Raises:
        InputError: two eyes are asked of a machine that renders one, a warped eye in a joint frame of a machine without, or a
            packed frame of a machine that packs none.
    """
    if isinstance(second, JointRegisters) and second.warping:
        check_joint_warp(config)
    if second is not None:
        (with_joint_frames if isinstance(second, JointRegisters) else with_two_eyes)(config)
    contents = {**(gaussians or gaussian_bytes(config, words)), "tiles": tile_bytes(config, registers)}
    if isinstance(second, JointRegisters):
        contents["supertiles"] = joint_supertile_bytes(config, second)
        contents["target_tiles"] = tile_bytes(config, second.target, second.warping and second.warping.warp)
        display = display or second.warping is not None
    elif config.supertiles:
        contents["supertiles"] = supertile_bytes(config, registers)
    if isinstance(second, StereoRegisters):
        contents["target_tiles"] = tile_bytes(config, second.target, second.warp)
        display = True
    shift = view_shift(registers, *([second.target] if second else []))
    lists = frame_lists(config) if config.supertiles else len(registers.header)
    if packed:
        with_packed_frames(config)
        display = True
    pixel_bytes = DISPLAY_PIXEL_BYTES if display else PIXEL_BYTES
    whole = -(-registers.width * registers.height * pixel_bytes // BEAT_BYTES)
    beats = {name: len(rows) for name, rows in contents.items()} | {
        "views": len(words.geometry) << shift, "directory": lists * DIRECTORY_BEATS, "entries": entries_beats,
        "spill": spill_beats, "frame": packed_beats(registers.width, registers.height) if packed else whole}
    if config.supertiles:
        del beats["views"]
    if second is not None:
        beats["target_frame"] = beats["frame"]
    regions = lay_out(beats)
    settings = {
        **_view_settings(config, registers), "gaussians": len(words.geometry), "sh_degree": words.sh_degree,
        "beta": beta or 0, "auto_beta": int(beta is None), "obb": int(obb), "display": int(display),
        **{f"{name}_base": region.base for name, region in regions.items()},
        "entries_beats": entries_beats, "spill_beats": spill_beats,
    }
    if not config.supertiles:
        settings["view_shift"] = shift
    if config.packed:
        settings["packed"] = int(packed)
    if words.chunks is not None:
        settings["chunks"] = len(words.chunks)
    if config.stereo or config.joint:
        settings |= _second_eye(config, second) | settings
    return MemoryImage(config, registers.width, registers.height, regions, settings, contents)


def _second_eye(config: AcceleratorConfig, second: StereoRegisters | JointRegisters | None) -> dict[str, int | list[int]]:
    """The settings of the target eye, except its bases. For a frame of one eye they get values that must not matter."""
    if second is None:
        kinds = (name for name in ("joint", "stereo") if getattr(config, name))
        return {**dict.fromkeys(kinds, 0), **{
            f.name: [f.raw_range[1]] * f.count if f.count > 1 else f.raw_range[1]
            for f in frame_settings(config).fields if f.name in _SECOND_EYE}}
    if isinstance(second, JointRegisters):
        return {"joint": 1, "shift": second.shift, "shared_colour": int(second.shared_colour),
                "target_position": _view_settings(config, second.target)["position"], **_warping(config, second.warping)}
    return {
        "stereo": 1, "source_right": int(second.source_right), "disparity_scale": second.disparity_scale,
        "target_position": _view_settings(config, second.target)["position"]}


def _warping(config: AcceleratorConfig, warping: JointWarping | None) -> dict[str, int]:
    """The settings of a joint frame about its warped target; where nothing is warped, values that must not matter."""
    if not config.stereo:
        return {}
    if warping is None:
        return {"stereo": 0, **{f.name: f.raw_range[1] for f in frame_settings(config).fields if f.name in _WARPING}}
    return {"stereo": 1, "source_right": int(warping.source_right), "disparity_scale": warping.disparity_scale,
            "second_sweep": int(warping.second_sweep)}


def _view_settings(config: AcceleratorConfig, registers: FrameRegisters) -> dict[str, int | list[int]]:
    """The settings that have the names of fields of `FrameRegisters`; floats become bit patterns."""
    settings = {}
    for f in frame_settings(config).fields:
        if hasattr(registers, f.name):
            values = np.atleast_1d(getattr(registers, f.name)).reshape(-1)
            raw = (f.format.quantise(values) if isinstance(f.format, SmallFloat) else values).astype(np.int64).tolist()
            settings[f.name] = raw if f.count > 1 else raw[0]
    return settings


def read_frame(
    config: AcceleratorConfig, data: np.ndarray, width: int, height: int, *, display: bool = False,
) -> FramePixels | DisplayPixels:
    """The pixels of a frame from its bytes.

    Args:
        config: the machine.
        data: uint8, at least as many bytes as the frame's pixels take.
        width, height: size of the frame in pixels.
        display: whether the frame has the format for displays.
    """
    record, kind = (display_pixel(config), DisplayPixels) if display else (frame_pixel(config), FramePixels)
    kinds = [(f.name, f"<u{f.format.width // 8}", (f.count,) if f.count > 1 else ()) for f in record.fields]
    pixels = data[: width * height * record.width // 8].view(np.dtype(kinds)).reshape(height, width)
    return kind(*(pixels[name].astype(np.int64) for name in kind._fields))


def read_packed(data: np.ndarray, width: int, height: int) -> PackedPixels:
    """A packed frame of so many pixels from its bytes, whether or not it is whole."""
    pixels, errors = unpack_blocks(data, width, height)
    beats = data[: BEAT_BYTES * packed_beats(width, height)].reshape(-1, BEAT_BYTES)
    return PackedPixels(pixels[..., :3].astype(np.int64), pixels[..., 3].astype(np.int64), beats, errors)


def spill_beats(config: AcceleratorConfig, group_counts: np.ndarray) -> int:
    """Number of beats to reserve for the sorted runs of a frame's groups: twice what the largest spilled group needs.

    One half of the region holds runs while they are sorted, the other half the runs of one group while they are merged.
    """
    chunk = config.sort_chunk
    largest = int(np.max(group_counts, initial=0))
    runs = -(-largest // chunk) if largest > chunk else 1
    return 4 * runs * chunk // BEAT_ENTRIES
