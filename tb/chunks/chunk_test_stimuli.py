"""Stimuli of the chunk test: headers made by hand at the limits of the arithmetic, random headers, and those of models."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from golden.host.quantise import quantise_model
from golden.host.registers import FrameRegisters, frame_registers
from golden.msv2_ref.chunk_test import ChunkTest, judged_chunks, level_bounds
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.model import GaussianModel
from rtl.chunks.chunk_test import SETTINGS
from rtl.chunks.level_bounds import SIDES, octagon_layout
from spec.chunks import BOX_SHIFT, CHUNK, chunk_header, header_item
from spec.compact import STEP_BIAS
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.formats import SmallFloat
from spec.memory import frame_settings
from spec.records import INDEX_BITS, Record


@dataclass(frozen=True)
class Case:
    """Consecutive frames of one camera.

    Attributes:
        name: the case's name, for messages.
        config: the machine.
        frames: the headers of each frame, ChunkHeader records.
        gaussians: the model's number of Gaussians. Chunks may claim others.
        registers: the frame registers.
        rendered: (tiles,) bool, the tiles that are rendered; None: all.
        target: the registers of the target, in joint frames.
    """

    name: str
    config: AcceleratorConfig
    frames: tuple[np.ndarray, ...]
    gaussians: int
    registers: FrameRegisters
    rendered: np.ndarray | None = None
    target: FrameRegisters | None = None

    @property
    def chunks(self) -> int:
        """Number of chunks of all frames."""
        return sum(map(len, self.frames))

    def judged(self, frame: int) -> ChunkTest:
        """The golden results of a frame, in joint frames for the source."""
        return judged_chunks(self.config, self.frames[frame], self.gaussians, self.registers, self.rendered)

    @cached_property
    def read(self) -> list[np.ndarray]:
        """(C,) bool for each frame: whether each chunk is read, which in joint frames either eye decides."""
        read = [self.judged(frame).read for frame in range(len(self.frames))]
        if self.target is None:
            return read
        return [found | judged_chunks(self.config, headers, self.gaussians, self.target).read
                for found, headers in zip(read, self.frames, strict=True)]

    @property
    def ending(self) -> np.ndarray:
        """(1,) what stands in the fields of an item with `end`, which mean nothing: a chunk that would be read, if there is
        one, so that a unit that counts it is wrong."""
        headers, read = np.concatenate(self.frames), np.concatenate(self.read)
        return np.concatenate([headers[read], headers, np.zeros(1, headers.dtype)])[:1]

    @property
    def items(self) -> np.ndarray:
        """The HeaderItem items of all frames."""
        return np.concatenate([header_items(self.config, headers, self.ending) for headers in self.frames])

    @property
    def tested(self) -> np.ndarray:
        """The items that must leave the unit."""
        return np.concatenate([header_items(self.config, headers, self.ending, read)
                               for headers, read in zip(self.frames, self.read, strict=True)])

    @property
    def observed(self) -> dict[str, int]:
        """The counters after the last frame."""
        read = self.read[-1]
        return {"chunks_read": int(read.sum()), "chunks_skipped": int((~read).sum())}

    @property
    def settings(self) -> dict[str, int]:
        """Bit patterns of the unit's settings."""
        fields = {f.name: f for f in frame_settings(self.config).fields}
        found = {}
        others = {"gaussians": self.gaussians}
        if self.config.joint:
            others["target_position"] = (self.target or self.registers).position
        for name in {*SETTINGS, *others}:
            f, value = fields[name], np.ravel(others[name] if name in others else getattr(self.registers, name))
            raw = f.format.quantise(value).tolist() if isinstance(f.format, SmallFloat) else value.tolist()
            found[name] = Record(name, "", (f,)).pack({name: raw})
        found |= {"bounds": bounds_pattern(self.config, self.registers, self.rendered)}
        if self.config.joint:
            joint = self.target is not None
            found |= {"joint": int(joint), "target_bounds": bounds_pattern(self.config, self.target, None) if joint else 0}
        return found


def header_items(
    config: AcceleratorConfig, headers: np.ndarray, ending: np.ndarray, kept: np.ndarray | None = None,
) -> np.ndarray:
    """The items of those headers of a frame that are `kept`, (N,) bool, or of all; the last one is the frame's `end`, whose
    other fields are those of `ending`, (1,)."""
    numbers = np.arange(len(headers)) if kept is None else np.flatnonzero(kept)
    items = np.zeros(len(numbers) + 1, header_item(config).dtype)
    for name in headers.dtype.names:
        items[name][:-1] = headers[name][numbers]
        items[name][-1:] = ending[name]
    if config.supertiles:
        items["number"][:-1] = numbers
    items["end"][-1] = 1
    return items


def octagon_patterns(config: AcceleratorConfig, registers: FrameRegisters, rendered: np.ndarray | None) -> list[int]:
    """The bit pattern of the octagon of every quality bound."""
    bounds = level_bounds(registers.header[:, 0], registers.tiles_x, rendered)
    return [octagon_layout(config).const({
        "present": int(bounds.present[b]),
        **{end: dict(zip(SIDES, getattr(bounds, end)[b].tolist(), strict=True)) for end in ("least", "most")}}).as_bits()
        for b in range(MAX_LEVELS)]


def bounds_pattern(config: AcceleratorConfig, registers: FrameRegisters, rendered: np.ndarray | None) -> int:
    """The bit pattern of all octagons."""
    width = octagon_layout(config).size
    return sum(bits << i * width for i, bits in enumerate(octagon_patterns(config, registers, rendered)))


def cloud(rng: np.random.Generator, count: int) -> GaussianModel:
    """Gaussians around the origin that are used by one level or more."""
    return GaussianModel(
        means=rng.normal(0, 3, (count, 3)), log_scales=rng.normal(-2.5, 1, (count, 3)), quats=rng.normal(size=(count, 4)),
        opacity=rng.uniform(0, 1, (count, MAX_LEVELS)), sh_dc=np.zeros((count, MAX_LEVELS, 3)), sh_rest=np.zeros((count, 0, 3)),
        quality_bound=rng.integers(1, MAX_LEVELS + 1, count).astype(np.uint8))


def camera(rng: np.random.Generator, size: tuple[int, int], turned: bool = True) -> Camera:
    """A camera of any focal length; without `turned`, at the origin, looking along z."""
    width, height = size
    focal = max(size) * 2 ** rng.uniform(-2, 3)
    centre = width * rng.uniform(0.2, 0.8), height * rng.uniform(0.2, 0.8)
    q = np.linalg.qr(rng.normal(size=(3, 3)))[0] if turned else np.eye(3)
    q = q * np.sign(np.linalg.det(q))
    near = float(rng.choice([0.2, 1.0, 10 ** rng.uniform(-3, 1)]))
    return Camera(q, rng.normal(size=3) if turned else np.zeros(3), focal, focal * rng.uniform(0.7, 1.4), *centre, width,
                  height, near=near)


def view(config: AcceleratorConfig, rng: np.random.Generator, c: Camera) -> FrameRegisters:
    """The frame registers of a camera whose gaze is anywhere on the frame."""
    gaze = tuple(float(rng.choice([0.0, 0.5, 1.0, rng.random()])) * size for size in (c.width, c.height))
    levels = foveation_map(Display(c.width, c.height, float(rng.uniform(60, 140))), gaze, MAX_LEVELS)
    return frame_registers(config, c, quantise_model(config, cloud(rng, 1)), levels, np.zeros(3))


def any_headers(config: AcceleratorConfig, rng: np.random.Generator, count: int) -> np.ndarray:
    """Headers with any bits."""
    rows = np.zeros(count, chunk_header(config).dtype)
    for f in chunk_header(config).fields:
        rows[f.name] = rng.integers(*f.raw_range, rows[f.name].shape, endpoint=True)
    return rows


def boxes(
    config: AcceleratorConfig, rng: np.random.Generator, low: np.ndarray, size: np.ndarray, sigma: np.ndarray,
) -> np.ndarray:
    """Headers of boxes with these corners and sizes, (C, 3), and with largest standard deviations (C,)."""
    n, rows = config.formats, np.zeros(len(low), chunk_header(config).dtype)
    step = np.ceil(np.log2(np.maximum(size, 2.0**-32))) + STEP_BIAS - BOX_SHIFT - rng.integers(0, 9, size.shape)
    rows["step"] = np.clip(step, 0, 63)
    units = np.ceil(size / np.ldexp(1.0, rows["step"].astype(int) + BOX_SHIFT - STEP_BIAS)) - 1
    rows["low"], rows["extent"] = n.position.quantise(low), np.clip(units, 0, 255)
    rows["scale_top"] = np.clip(np.ceil(16 * (np.log2(np.maximum(sigma, 1e-12)) + n.scale.bias)), 0, 1023)
    rows["opacity"], rows["bound"] = rng.integers(1, 512, len(low)), rng.integers(0, MAX_LEVELS, len(low))
    rows["count"], rows["first"] = rng.integers(1, CHUNK + 1, len(low)), np.arange(len(low)) * CHUNK
    return rows


def seen(config: AcceleratorConfig, rng: np.random.Generator, r: FrameRegisters, count: int, spread: float = 0.3) -> np.ndarray:
    """Small boxes in and around the frame, at all depths before and behind the near plane."""
    pixel = np.stack([size * rng.uniform(-spread, 1 + spread, count) for size in (r.width, r.height)], 1)
    z = r.near * 2 ** rng.uniform(-1, 9, count)
    across = (pixel - r.centre / (1 << config.formats.mean2d.frac_bits)) * z[:, None]
    place = np.linalg.solve(r.rotation, np.column_stack([across, z]).T).T + r.position
    size = z[:, None] * 10 ** rng.uniform(-6, 0.3, (count, 3))
    return boxes(config, rng, place - size * rng.random((count, 3)), size, z * 10 ** rng.uniform(-6, 0, count))


def at_near(config: AcceleratorConfig, rng: np.random.Generator, r: FrameRegisters, count: int) -> np.ndarray:
    """Boxes whose far side is at the near plane, but for a few ulps."""
    rows = seen(config, rng, r, count)
    size = np.ldexp(rows["extent"] + 1.0, rows["step"].astype(int) + BOX_SHIFT - STEP_BIAS)
    depth = r.near * (1 + rng.integers(-40, 41, count) * 2.0**-15) - size @ np.maximum(r.rotation[2], 0) - size @ np.minimum(
        r.rotation[2], 0)
    low = np.linalg.solve(r.rotation, np.column_stack([rng.normal(size=(count, 2)) * r.near, depth]).T).T + r.position
    rows["low"] = config.formats.position.quantise(low)
    return rows


def corners(config: AcceleratorConfig, rng: np.random.Generator, r: FrameRegisters, count: int) -> np.ndarray:
    """Boxes in the frame with fields at the ends of their ranges."""
    rows = seen(config, rng, r, count, 0.05)
    for f in chunk_header(config).fields:
        ends = [0, 1, f.raw_range[1], f.raw_range[1] - 1]
        where = rng.random(rows[f.name].shape) < (0.03 if f.name == "low" else 0.12)
        rows[f.name] = np.where(where, rng.choice(ends, rows[f.name].shape), rows[f.name])
    return rows


def extreme(config: AcceleratorConfig, rng: np.random.Generator, r: FrameRegisters, count: int) -> np.ndarray:
    """Boxes of any size at any distance, so that sums and products saturate or vanish."""
    place = np.sign(rng.normal(size=(count, 3))) * 2.0 ** rng.uniform(-126, 128, (count, 3))
    return boxes(config, rng, place, 2.0 ** rng.uniform(-40, 40, (count, 3)), 2.0 ** rng.uniform(-39, 24, count))


KINDS: dict[str, Callable[[AcceleratorConfig, np.random.Generator, FrameRegisters, int], np.ndarray]] = {
    "seen": seen, "at the near plane": at_near, "ends of fields": corners, "extreme": extreme,
    "any bits": lambda config, rng, r, count: any_headers(config, rng, count)}
"""Makers of headers by the kind of a case."""


def case_of(
    config: AcceleratorConfig, rng: np.random.Generator, kind: str, count: int = 300, size: tuple[int, int] | None = None,
    **options: bool,
) -> Case:
    """A frame with headers of a kind."""
    size = size or (int(rng.integers(1, config.row_width + 1)), int(rng.integers(1, min(config.row_width, 1080) + 1)))
    registers = view(config, rng, camera(rng, size, **options))
    if kind == "extreme":
        registers = replace(registers, rotation=config.formats.view.round(registers.rotation * 2.0 ** rng.integers(0, 90)))
    tiles = len(registers.header)
    rendered = [None, rng.random(tiles) < 0.1, np.zeros(tiles, bool), np.arange(tiles) == rng.integers(tiles)][rng.integers(4)]
    headers = KINDS[kind](config, rng, registers, count)
    return Case(kind, config, (headers,), some_gaussians(rng, headers), registers, rendered)


def some_gaussians(rng: np.random.Generator, headers: np.ndarray) -> int:
    """A model's number of Gaussians that leaves out none of these chunks, or the last few, or cuts one in two."""
    ends = np.sort(headers["first"].astype(np.int64) + headers["count"])
    most = (1 << INDEX_BITS) - 1
    return int(rng.choice([most, min(ends[-1], most), min(ends[-1 - len(ends) // 8] - rng.integers(0, 2), most)]))


def for_two_eyes(config: AcceleratorConfig, rng: np.random.Generator, case: Case, distance: float) -> Case:
    """The case as a joint one, in which the target looks from another position, at another gaze."""
    gaze = tuple(float(rng.random()) * size for size in (case.registers.width, case.registers.height))
    levels = foveation_map(Display(case.registers.width, case.registers.height, 100.0), gaze, MAX_LEVELS)
    moved = config.formats.view.round(case.registers.position + distance * rng.normal(size=3))
    level, blend = levels.tile_level.reshape(-1).astype(np.int64), levels.blend.reshape(-1).astype(np.int64)
    header = np.stack([level, blend, (level > 0).astype(np.int64)], 1)
    return replace(case, rendered=None, target=replace(case.registers, position=moved, header=header))


def mixed_case(config: AcceleratorConfig, rng: np.random.Generator, name: str, counts: list[int]) -> Case:
    """Frames with so many headers of all kinds."""
    case = case_of(config, rng, "seen", 1)
    makers = [make for kind, make in KINDS.items() if kind != "extreme"]
    frames = [np.concatenate([make(config, rng, case.registers, len(part)) for make, part in zip(
        makers, np.array_split(np.arange(count), len(makers)), strict=True)]) for count in counts]
    gaussians = some_gaussians(rng, np.concatenate(frames))
    return replace(case, name=name, frames=tuple(map(rng.permutation, frames)), gaussians=gaussians)


def model_case(config: AcceleratorConfig, rng: np.random.Generator, count: int) -> Case:
    """The chunks of a random model, seen by a camera among its splats."""
    words = quantise_model(config, cloud(rng, count))
    return replace(case_of(config, rng, "seen", 1), name=f"model of {count}", frames=(words.chunks,),
                   gaussians=len(words.geometry))


def sharp_case(config: AcceleratorConfig, rng: np.random.Generator, size: tuple[int, int], count: int) -> Case:
    """A frame of boxes at positions where the smallest step of `low` decides whether the chunk is read: pairs of headers, the
    first of which is read, the second not. The boundary is that of the frame, of a level, or the near plane."""
    case, to = replace(case_of(config, rng, "seen", 1, size), rendered=None), config.formats.position
    parts, most = [], (1 << INDEX_BITS) - 1

    def read(headers: np.ndarray) -> np.ndarray:
        return judged_chunks(config, headers, most, case.registers).read

    while sum(map(len, parts)) < count:
        inner, outer = (seen(config, rng, case.registers, 4 * count, 0.1) for _ in range(2))
        for name in inner.dtype.names:
            if name != "low":
                outer[name] = inner[name]
        chosen = read(inner) & ~read(outer)
        inner, outer = inner[chosen], outer[chosen]
        for _ in range(to.sig_bits + 8):
            middle = outer.copy()
            middle["low"] = to.quantise((to.to_float(inner["low"]) + to.to_float(outer["low"])) / 2)
            inside = read(middle)
            inner["low"][inside], outer["low"][~inside] = middle["low"][inside], middle["low"][~inside]
        parts.append(np.stack([inner, outer], 1).reshape(-1))
    headers = np.concatenate(parts)[:count]
    return replace(case, name=f"where an ulp decides, {size[0]}x{size[1]}", frames=(headers,), gaussians=most)


def uniform_case(config: AcceleratorConfig, rng: np.random.Generator, read: bool, count: int) -> Case:
    """A frame whose chunks are all read, or all skipped."""
    case = replace(case_of(config, rng, "seen", 1, (256, 256)), rendered=None, gaussians=count * CHUNK)
    found: list[np.ndarray] = []
    while sum(map(len, found)) < count:
        headers = seen(config, rng, case.registers, count)
        found.append(headers[judged_chunks(config, headers, case.gaussians, case.registers).read == read])
    return replace(case, name="rate read" if read else "rate skipped", frames=(np.concatenate(found)[:count],))
