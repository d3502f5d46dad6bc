"""Cases 70 to 73: frames of machines with super-tiles, whose tiles leave the array and come back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from golden.host.quantise import quantise_model
from golden.msv2_ref.array import Pixels, render_tiles, render_visits
from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.pipeline import Frame, render
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, FoveationMap, no_foveation
from golden.scenes.model import GaussianModel
from msv2.cases.case import Case, require
from msv2.cases.check import MACHINE
from msv2.cases.chunks import CHUNK_MACHINE
from msv2.cases.makers import splats, view
from spec.tables import t_stop

SUPER_MACHINE = CHUNK_MACHINE.with_(
    name=f"{MACHINE.name}_small_batches", lists="supertile", list_heads=128, header_lines=16, batch_places=16)
"""The configuration that plays frames of super-tiles. A batch has 13 to 16 places, so that few splats make many batches."""

BACKGROUND = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class InSuperTiles:
    """A frame of a machine with super-tiles.

    Attributes:
        model, camera: the model and the camera.
        pairs: the number of pairs of each super-tile.
        batches: the number of batches of each super-tile.
        foveation: the levels that the tiles show; None: level 1.
        further: raises CaseFailure where the frame is not what the case is about; None: nothing more.
    """

    model: GaussianModel
    camera: Camera
    pairs: tuple[int, ...]
    batches: tuple[int, ...]
    foveation: FoveationMap | None = None
    further: Callable[[Frame, FrameBatches], None] | None = None

    def check(self, name: str) -> Frame:
        """The frame; CaseFailure where a pixel is not that of lists by tile, or of the visits of its tiles, or where pairs and
        batches are not as many as they must be."""
        words = quantise_model(SUPER_MACHINE, self.model)
        frame, whole = (render(words, self.camera, config=config, foveation=self.foveation, background=BACKGROUND)
                        for config in (SUPER_MACHINE, CHUNK_MACHINE))
        require(_same(frame.pixels, whole.pixels), f"{name}: every pixel must be that of lists by tile")
        of = FrameBatches(frame)
        tile = of.visits.tile[of.visits.final]
        visited = render_visits(frame.config, of.visit_records, of.entry_records, frame.registers.background)
        require(_same(visited, Pixels(*(part[tile] for part in frame.pixels))),
                f"{name}: visits must leave every pixel as whole lists do")
        require(sorted(tile.tolist()) == list(range(len(frame.registers.header))), f"{name}: every tile must be finished once")
        supertiles = len(frame.pairs.start) - 1
        for what, found in (("pairs", np.diff(frame.pairs.start)),
                            ("batches", np.bincount(of.batches.supertile, minlength=supertiles))):
            require(tuple(found.tolist()) == getattr(self, what),
                    f"{name}: {what} must be {getattr(self, what)}, not {tuple(found.tolist())}")
        if self.further:
            self.further(frame, of)
        return frame


def _same(one: Pixels, other: Pixels) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def _at(camera: Camera, *pixels: tuple[float, float], depth: float = 2.0) -> list[tuple[float, float, float]]:
    """Means that the camera sees at these pixels."""
    return [((x - camera.cx) * depth / camera.fx, (y - camera.cy) * depth / camera.fy, depth) for x, y in pixels]


def _behind(camera: Camera, pixel: tuple[float, float], count: int) -> list[tuple[float, float, float]]:
    """So many means that the camera sees at this pixel, at depths from 2 on."""
    return [place for n in range(count) for place in _at(camera, pixel, depth=2.0 + 0.002 * n)]


def _empty() -> Mapping[str, InSuperTiles]:
    """Two rows of two super-tiles. One splat lies inside a tile of the first, one inside a tile of the last, nothing in the
    others; and a model of which nothing is seen."""
    camera = view(160, 64)
    dots = splats(*_at(camera, (24, 8), (136, 56)), scale=0.02)
    return {"between": InSuperTiles(dots, camera, (1, 0, 0, 1), (1, 1, 1, 1), further=_one_tile_each),
            "everywhere": InSuperTiles(splats((0, 0, -1)), camera, (0, 0, 0, 0), (1, 1, 1, 1))}


def _one_tile_each(frame: Frame, of: FrameBatches) -> None:
    masks = of.pairs.mask.tolist()
    require(masks == [1 << 1, 1 << 8], f"the splats must lie in one tile each, not in those of {masks}")
    require(len(of.visits.tile) == len(frame.registers.header), "tiles without splats must be visited once, too")


def _stopped() -> Mapping[str, InSuperTiles]:
    """A tile behind eight opaque splats that cover it and less of its neighbours, and 510 faint splats that lie in it and in
    the next tile; and the same where all 16 tiles are covered."""
    camera, found = view(128, 32), {}
    faint = _behind(camera, (16, 8), 510)
    for label, scale, place in (("one tile", 0.16, (8, 8)), ("every tile", 5.0, (64, 16))):
        model = splats(*_at(camera, *[place] * 8, depth=0.5), *faint, scale=[[scale] * 3] * 8 + [[0.1] * 3] * 510,
                       opacity=[1.0] * 8 + [0.02] * 510)
        found[label] = InSuperTiles(model, camera, (518,), (40,), further=_first_batch_stops)
    return found


def _first_batch_stops(frame: Frame, of: FrameBatches) -> None:
    """Raises CaseFailure unless the first batch stops tile 0, and later ones have entries of it."""
    headers, entries, first = frame.headers[:1].copy(), frame.array_entries, of.batch_of_pair[of.pairs.intersection] == 0
    inside = np.arange(len(entries)) < frame.entries.start[1]
    headers["count"] = (first & inside).sum()
    pixels = render_tiles(frame.config, headers, entries[first & inside], frame.registers.background)
    require((pixels.transmittance < t_stop(frame.config.formats)).all(), "the first batch must stop the tile")
    visits = of.visits.batch[of.visits.tile == 0]
    require(len(visits) == 40, f"all 40 batches must have places of the tile, not {len(visits)}")


def _one_bank() -> Mapping[str, InSuperTiles]:
    """A blend tile whose next level sees opaque splats in front, which its own level hardly sees; and the other way round. 60
    splats follow in both levels."""
    camera = view(128, 32)
    flat = no_foveation(Display(128, 32))
    plane = np.broadcast_to([0.4, 0.01, -0.005], flat.plane.shape).copy()
    fov = replace(flat, levels=2, blend=np.ones_like(flat.blend), plane=plane)
    places = _behind(camera, (64, 16), 60)
    model = splats(*_at(camera, *[(64, 16)] * 4, depth=0.5), *places, scale=[[5.0] * 3] * 4 + [[1.0] * 3] * 60, levels=2)
    found = {}
    for label, front in (("the next level's", (0.05, 1.0)), ("its own", (1.0, 0.05))):
        opacity = np.concatenate([np.tile(front, (4, 1)), np.full((60, 2), 0.02)])
        stopped = int(front[1] > front[0])
        found[label] = InSuperTiles(replace(model, opacity=opacity), camera, (64,), (5,), fov,
                                    lambda frame, of, stopped=stopped: _only_bank(frame, of, stopped))
    return found


def _only_bank(frame: Frame, of: FrameBatches, stopped: int) -> None:
    """Raises CaseFailure unless the first batch stops this bank of every tile, and no later one the other."""
    batch, limit = of.batch_of_pair[of.pairs.intersection], t_stop(frame.config.formats)
    for bank in (0, 1):
        for part, most in ((batch == 0, True), (batch >= 0, False)):
            entries, headers = frame.array_entries[part], frame.headers.copy()
            if bank:
                for name in ("use", "log2_opacity"):
                    entries[name] = entries[name][:, ::-1]
            headers["blend"], headers["outer"] = 0, bank
            headers["count"] = np.add.reduceat(part, frame.entries.start[:-1])
            left = render_tiles(frame.config, headers, entries, frame.registers.background).transmittance
            if bank == stopped and most:
                require((left < limit).all(), f"the first batch must stop bank {bank}")
            if bank != stopped and not most:
                require((left >= limit).all(), f"bank {bank} must not stop")


def _cut() -> Mapping[str, InSuperTiles]:
    """Frames whose last super-tiles are cut by the right edge, the lower edge and both; the smallest frame; all with splats in
    every tile."""
    frames = {}
    for (width, height), pairs in {(152, 32): (60, 60), (128, 56): (60, 60), (152, 56): (60,) * 4, (1, 1): (60,)}.items():
        model, camera = splats(*[(0, 0, 2 + 0.1 * n) for n in range(60)], scale=8.0, opacity=0.03), view(width, height)
        frames[f"{width}x{height}"] = InSuperTiles(model, camera, pairs, (5,) * len(pairs))
    return frames


def _case(number: int, name: str, what: str, expected: str, frames: Callable[[], Mapping[str, InSuperTiles]]) -> Case:
    """A case of super-tiles: all its checks are on the integer renderer and the machine."""
    def check() -> None:
        for label, frame in frames().items():
            frame.check(label)

    return Case(number, name, what, expected, checks={"golden": check}, supertiles=frames,
                absent={"oracle": "it has no super-tiles", "gradient": "it has no super-tiles"})


EMPTY_SUPER_TILES = _case(
    70, "empty-super-tiles", "two dots in four super-tiles, and a frame without splats",
    "every tile is visited once and shows the background; the dots are pairs of one tile each", _empty)
STOPPED_EARLY = _case(
    71, "stopped-in-batch-1-of-40", "a tile, or all, behind eight opaque splats, and 510 faint ones behind them",
    "the first of 40 batches stops the tile; what follows changes no bit of it", _stopped)
ONE_BANK_STOPPED = _case(
    72, "one-bank-stopped", "blend tiles of which one level is opaque and the other is not",
    "the first of five batches stops one level; the other goes on, whichever it is", _one_bank)
CUT_SUPER_TILES = _case(
    73, "cut-super-tiles", "super-tiles cut by the right edge, the lower edge and both, and a frame of one pixel",
    "no tile beyond the frame is visited", _cut)

CASES = (EMPTY_SUPER_TILES, STOPPED_EARLY, ONE_BANK_STOPPED, CUT_SUPER_TILES)
