"""Stimuli of the projection unit: points made by hand at the limits of the arithmetic, random points, and rendered frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from golden.host.quantise import GaussianWords
from golden.host.registers import FrameRegisters, frame_registers
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.projection import FAINT, NEAR, OUTSIDE, project, projected_splats
from golden.msv2_ref.saturations import misplaced
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, no_foveation
from spec import tables
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.formats import SmallFloat
from spec.memory import frame_settings
from spec.records import Record, gaussian_colour, gaussian_geometry, gaussian_point, opacities_carried

SETTINGS = ("position", "rotation", "turn", "centre", "limits", "near", "depth_scale", "width", "height")
REASONS = {"culled_near": NEAR, "culled_faint": FAINT, "culled_outside": OUTSIDE}


@dataclass(frozen=True)
class Case:
    """Consecutive frames of one camera.

    Attributes:
        name: the case's name, for messages.
        config: the machine's configuration.
        frames: the quantised Gaussians of each frame.
        registers: the frame registers, which hold the camera.
    """

    name: str
    config: AcceleratorConfig
    frames: tuple[GaussianWords, ...]
    registers: FrameRegisters

    @property
    def points(self) -> int:
        """Number of points of all frames."""
        return sum(len(words.geometry) for words in self.frames)

    @property
    def items(self) -> np.ndarray:
        """The GaussianPoint items of all frames."""
        rows = np.zeros(self.points + len(self.frames), gaussian_point(self.config).dtype)
        at = 0
        for words in self.frames:
            count = len(words.geometry)
            for name in words.geometry.dtype.names:
                strongest = name == "log2_opacity" and opacities_carried(self.config) == 1
                rows[name][at : at + count] = words.decoded.opacity if strongest else words.geometry[name]
            rows["index"][at : at + count] = np.arange(count)
            rows["end"][at + count] = 1
            at += count + 1
        return rows

    @property
    def splats(self) -> np.ndarray:
        """The splats that the golden renderer projects from the points."""
        return np.concatenate([projected_splats(self.config, words, self.registers) for words in self.frames])

    @property
    def observed(self) -> dict[str, int]:
        """The counters after the last frame."""
        projected = project(self.config, self.frames[-1], self.registers)
        culled = {name: int((projected.reason == code).sum()) for name, code in REASONS.items()}
        return {**culled, "saturated_means": int(misplaced(projected).sum())}

    @property
    def settings(self) -> dict[str, int]:
        """Bit patterns of the unit's settings."""
        fields = {f.name: f for f in frame_settings(self.config).fields}
        found = {}
        for name in SETTINGS:
            f, value = fields[name], np.ravel(getattr(self.registers, name))
            raw = f.format.quantise(value).tolist() if isinstance(f.format, SmallFloat) else value.tolist()
            found[name] = Record(name, "", (f,)).pack({name: raw})
        return found


def words_of(config: AcceleratorConfig, geometry: np.ndarray) -> GaussianWords:
    """Quantised Gaussians with these geometry records; their colours are black."""
    colour = np.zeros(len(geometry), gaussian_colour(config, 0).dtype)
    return GaussianWords(config, geometry, colour, np.zeros(3), MAX_LEVELS, 0, {})


def camera(width: int, height: int, turned: bool = True) -> Camera:
    """A camera with unequal focal lengths that is turned and moved, or one at the origin that looks along z."""
    if not turned:
        return Camera(np.eye(3), np.zeros(3), width, width, width / 2, height / 2, width, height)
    a, b = np.deg2rad(25), np.deg2rad(-14)
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return Camera(about_x @ about_y, np.array([0.3, -0.7, 1.5]), 0.8 * width, 0.95 * width, 0.55 * width, 0.4 * height, width,
                  height)


def view(config: AcceleratorConfig, c: Camera, far: float = 20.0) -> FrameRegisters:
    """The frame registers of a camera. The depth key saturates at the distance `far`."""
    along = c.position + c.rotation.T @ np.array([0, 0, far])
    geometry = np.zeros(1, gaussian_geometry(config).dtype)
    geometry["mean"] = config.formats.position.quantise(along)
    flat = no_foveation(Display(c.width, c.height))
    return frame_registers(config, c, words_of(config, geometry), flat, np.zeros(3))


def random_geometry(config: AcceleratorConfig, rng: np.random.Generator, count: int) -> np.ndarray:
    """Records at the origin with ordinary sizes and opacities. A part of the rotations is not normalised."""
    n = config.formats
    rows = np.zeros(count, gaussian_geometry(config).dtype)
    quat = rng.normal(size=(count, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True) * rng.choice([1.0, 1.0, 1.0, 0.7], (count, 1))
    rows["quat"] = n.quaternion.quantise(quat)
    rows["scale"] = n.scale.quantise(np.exp(rng.normal(-2.5, 1, (count, 3))))
    rows["log2_opacity"] = n.log2_opacity.quantise(rng.uniform(-5, 4, (count, MAX_LEVELS)))
    rows["bound"] = rng.integers(0, MAX_LEVELS, count)
    return rows


def place(config: AcceleratorConfig, rows: np.ndarray, c: Camera, pixels: np.ndarray, z: np.ndarray) -> None:
    """Moves the points so that the camera sees them at `pixels` (N, 2), at the distance `z` in front of it."""
    xy = (pixels - [c.cx, c.cy]) / [c.fx, c.fy]
    world = (np.column_stack([xy, np.ones(len(z))]) * z[:, None]) @ c.rotation + c.position
    rows["mean"] = config.formats.position.quantise(world)


Edit = Callable[[AcceleratorConfig, np.random.Generator, np.ndarray, Camera], None]


def _behind(config, rng, rows, c):
    place(config, rows, c, rng.uniform(0, 300, (len(rows), 2)), rng.uniform(-10, c.near, len(rows)))


def _near_plane(config, rng, rows, c):
    """z is exactly at the near plane or a few ulps away from it, for a camera that looks along z."""
    near = int(config.formats.view.quantise(c.near))
    rows["mean"][:, 2] = near + rng.integers(-3, 4, len(rows))


def _faint(config, rng, rows, c):
    """Opacities around the faintest visible one. Levels above the bound, which must be ignored, are bright."""
    faintest = tables.log2_alpha_min(config.formats)
    rows["log2_opacity"] = faintest + rng.integers(-2, 2, (len(rows), MAX_LEVELS))
    above = np.arange(MAX_LEVELS) > rows["bound"][:, None]
    rows["log2_opacity"][above] = config.formats.log2_opacity.raw_max


def _opacities(config, rng, rows, c):
    to = config.formats.log2_opacity
    rows["log2_opacity"] = rng.choice([to.raw_min, -8186, -1, 0, to.raw_max], (len(rows), MAX_LEVELS))


def _zero_scales(config, rng, rows, c):
    rows["scale"] *= rng.integers(0, 2, (len(rows), 3)).astype(rows["scale"].dtype)


def _huge_scales(config, rng, rows, c):
    top = (1 << config.formats.scale.width) - 1
    rows["scale"] = np.where(rng.random((len(rows), 3)) < 0.7, top - rng.integers(0, 3, (len(rows), 3)), rows["scale"])


def _needles(config, rng, rows, c):
    rows["scale"] = config.formats.scale.quantise(10.0 ** rng.uniform(-6, 2, (len(rows), 3)))


def _saturating_means(config, rng, rows, c):
    """Means around the largest one that its format holds and far beyond, with footprints so wide that some reach the frame."""
    pixels = rng.choice([-1, 1], (len(rows), 2)) * rng.choice([16384, 16383.99, 20000, 40000, 1e6, 100], (len(rows), 2))
    z = rng.uniform(1, 3, len(rows))
    place(config, rows, c, pixels, z)
    rows["scale"] = config.formats.scale.quantise(rng.uniform(0.1, 2000, (len(rows), 3)))


def _depths(config, rng, rows, c):
    """Depths around the one that saturates, and depths whose keys saturate."""
    place(config, rows, c, rng.uniform(0, 64, (len(rows), 2)), rng.choice([19.99, 20, 20.01, 50, 1e5, 1e9, 1e12], len(rows)))
    rows["scale"] = config.formats.scale.quantise(rng.uniform(1, 1e5, (len(rows), 3)))


def _edges(config, rng, rows, c):
    """Small footprints around the frame's edges and the borders of its tiles."""
    corner = rng.choice([-2, 0, 16, 32, c.width - 16, c.width, c.height, c.height + 2], (len(rows), 2))
    place(config, rows, c, corner + rng.uniform(-4, 4, (len(rows), 2)), rng.uniform(1, 5, len(rows)))
    rows["scale"] = config.formats.scale.quantise(rng.uniform(1e-4, 1e-2, (len(rows), 3)))


def _flipped(config, rng, rows, c):
    """Rotations at the ends of the format, exactly swapped axes, and zero quaternions."""
    to = config.formats.quaternion
    rows["quat"] = rng.choice([to.raw_min, to.raw_max, 0, 0, 1, -1], (len(rows), 4))


def _giants(config, rng, rows, c):
    """Points so near to a camera with hardly any near plane that they are too wide for the smallest factors of the conic."""
    place(config, rows, c, rng.uniform(0, 200, (len(rows), 2)), 10.0 ** rng.uniform(-11.9, -9, len(rows)))
    rows["scale"] = config.formats.scale.quantise(10.0 ** rng.uniform(-12, 7, (len(rows), 3)))


def _any_bits(config, rng, rows, c):
    """Random bits in every field."""
    for f in gaussian_geometry(config).fields:
        low, high = f.raw_range
        rows[f.name] = rng.integers(low, high + 1, rows[f.name].shape)


def _any_bits_in_view(config, rng, rows, c):
    """Random bits in every field except the mean."""
    means = rows["mean"].copy()
    _any_bits(config, rng, rows, c)
    rows["mean"] = means


EDITS: dict[str, Edit] = {
    "ordinary": lambda *_: None, "behind the camera": _behind, "on the near plane": _near_plane, "faintest opacities": _faint,
    "extreme opacities": _opacities, "zero scales": _zero_scales, "huge scales": _huge_scales, "needles": _needles,
    "saturating means": _saturating_means, "saturating depths": _depths, "edges of the frame": _edges,
    "extreme rotations": _flipped, "giants": _giants, "any bits": _any_bits, "any bits in view": _any_bits_in_view}
"""The changes that are made to ordinary visible points, by name."""


def case_of(
    config: AcceleratorConfig, rng: np.random.Generator, name: str, *, size: tuple[int, int] = (300, 200), count: int = 300,
    frames: int = 1, turned: bool = True,
) -> Case:
    """Frames of points that were changed by one of EDITS."""
    c = camera(*size, turned=turned and EDITS[name] not in (_near_plane, _giants))
    if EDITS[name] is _giants:
        c = replace(c, near=1e-12)
    return Case(f"{name}, {size[0]}x{size[1]}", config, tuple(
        words_of(config, edited(config, rng, name, c, count)) for _ in range(frames)), view(config, c))


PRINCIPAL_POINTS = ((-5000.0, 2500.0), (2500.0, -9000.0), (9000.0, 5000.0), (-700.0, 12000.0), (-12000.0, -700.0))
"""Principal points, in pixels, of cameras that see a part of a far larger image, beside its middle."""


def part_case(config: AcceleratorConfig, rng: np.random.Generator, number: int, count: int = 100) -> Case:
    """Ordinary points and points at the frame's edges, seen by a camera whose principal point, of this number in
    PRINCIPAL_POINTS, lies far outside of the frame."""
    cx, cy = PRINCIPAL_POINTS[number]
    c = replace(camera(300, 200), cx=cx, cy=cy, fx=6000.0, fy=7000.0)
    rows = np.concatenate([edited(config, rng, name, c, count) for name in ("ordinary", "edges of the frame")])
    return Case(f"principal point at {cx:.0f}, {cy:.0f}", config, (words_of(config, rows),), view(config, c))


def smallest_slant_case(config: AcceleratorConfig, rng: np.random.Generator, count: int = 6000) -> Case:
    """Splats whose second factor of the conic is the smallest number of its format, or rounded to it, and others in which it is
    just a little smaller or larger. They are hardly slanted, because they are very thin along the view and not turned."""
    n, c = config.formats, camera(300, 200, turned=False)
    rows = random_geometry(config, rng, count)
    place(config, rows, c, rng.uniform((170, 120), (290, 190), (count, 2)), rng.uniform(1, 4, count))
    rows["quat"], rows["log2_opacity"] = [n.quaternion.raw_max, 0, 0, 0], n.log2_opacity.quantise(0.5)
    rows["scale"][:, 2], least = n.scale.quantise(2.0 ** -rng.uniform(24, 26, count)), n.conic.min

    def slants() -> np.ndarray:
        return np.abs(project(config, words_of(config, rows), view(config, c)).conic[:, 1])

    thinner = np.sqrt(least / np.maximum(slants(), least))
    rows["scale"][:, 2] = n.scale.quantise(n.scale.to_float(rows["scale"][:, 2]) * thinner)
    chosen = (slants() == least) | (np.arange(count) < 100)
    return Case("smallest slants", config, (words_of(config, rows[chosen]),), view(config, c))


def edited(config: AcceleratorConfig, rng: np.random.Generator, name: str, c: Camera, count: int) -> np.ndarray:
    """Visible points, changed by the edit of this name."""
    rows = random_geometry(config, rng, count)
    place(config, rows, c, rng.uniform((0, 0), (c.width, c.height), (count, 2)), np.exp(rng.uniform(-1, 3, count)))
    EDITS[name](config, rng, rows, c)
    return rows


def mixed_case(config: AcceleratorConfig, rng: np.random.Generator, name: str, lengths: list[int]) -> Case:
    """Frames in which all kinds of points are mixed."""
    c, frames = camera(240, 180), []
    for length in lengths:
        parts = [edited(config, rng, kind, c, 1 + length // len(EDITS)) for kind in EDITS]
        frames.append(words_of(config, rng.permutation(np.concatenate(parts))[:length]))
    return Case(name, config, tuple(frames), view(config, c))


def uniform_case(config: AcceleratorConfig, rng: np.random.Generator, fate: str, count: int) -> Case:
    """Points with the same fate: all are rejected for one of REASONS, or all are projected ("visible")."""
    c = camera(300, 200)
    rows = random_geometry(config, rng, count)
    rows["log2_opacity"] = config.formats.log2_opacity.quantise(-12.0 if fate == "culled_faint" else 0.5)
    x = -5000.0 if fate == "culled_outside" else 150.0
    pixels = np.column_stack([np.full(count, x), rng.uniform(0, 200, count)])
    place(config, rows, c, pixels, np.full(count, -2.0 if fate == "culled_near" else 3.0))
    return Case(f"rate, {fate}", config, (words_of(config, rows),), view(config, c))


def guard_band_ends(config: AcceleratorConfig) -> tuple[int, ...]:
    """The ends of the range of raw means, and what lies one ulp to either side."""
    to = config.formats.mean2d
    return tuple(end + off for end in (to.raw_min, to.raw_max) for off in (-1, 0, 1))


def guard_band_case(config: AcceleratorConfig, rng: np.random.Generator, number: int, count: int = 200) -> Case:
    """Giants whose means lie exactly at an end of the guard band or an ulp of `mean2d` beside it: along x at the end of this
    number in `guard_band_ends`, along y at another one.

    There, slopes are multiples of some ulps of `mean2d`, so the principal point decides which raw means occur. The focal length
    and the distance are powers of two, so every slope is exact.
    """
    to, ends = config.formats.mean2d, guard_band_ends(config)
    step = 1 << max(0, to.int_bits + 1 + to.frac_bits - config.formats.view.sig_bits)  # between slopes beyond the range
    at = np.array([ends[number], ends[(number + 3) % len(ends)]])
    centre = (128 << to.frac_bits) + at % step
    c = replace(camera(256, 256, turned=False), cx=centre[0] / (1 << to.frac_bits), cy=centre[1] / (1 << to.frac_bits))
    inner = (rng.integers(0, 256 << to.frac_bits, (count, 2)) - centre) // step * step + centre
    chosen = rng.choice([1, 2, 3], count)[:, None] >> np.arange(2) & 1  # the axes along which a mean lies at an end
    raw = np.where(chosen, at + step * rng.choice([0, 0, 0, -1, 1], (count, 2)), inner)
    rows = random_geometry(config, rng, count)
    place(config, rows, c, raw / (1 << to.frac_bits), np.full(count, 2.0))
    rows["scale"] = config.formats.scale.quantise(rng.uniform(60, 400, (count, 3)) * 2.0 ** (to.int_bits - 14))
    return Case(f"guard band, end {number}", config, (words_of(config, rows),), view(config, c))


def traced_case(frame: Frame, name: str) -> Case:
    """The points of a rendered frame, of all of its chunks."""
    return Case(name, frame.config, (words_of(frame.config, frame.words.geometry),), frame.registers)


def shortened(case: Case, count: int) -> Case:
    """The case with no more than `count` points per frame, which are taken at equal distances."""
    def thinned(words: GaussianWords) -> GaussianWords:
        step = max(1, -(-len(words.geometry) // count))
        return words_of(case.config, words.geometry[::step])

    return replace(case, frames=tuple(thinned(words) for words in case.frames))
