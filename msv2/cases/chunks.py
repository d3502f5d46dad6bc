"""Cases 59 to 63 and 77: models in chunks, and ways in which a chunk could be skipped although something of it is seen, or be
read although it must not be."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from golden.host.quantise import GaussianWords, quantise_model
from golden.host.registers import frame_registers
from golden.msv2_ref.pipeline import Frame, render_frame
from golden.scenes.gaze import Display, no_foveation
from golden.scenes.model import GaussianModel
from msv2.cases.case import Case, require
from msv2.cases.check import MACHINE
from msv2.cases.files import columns_of, loaded
from msv2.cases.makers import splats, view
from spec.chunks import CHUNK
from spec.records import INDEX_BITS

CHUNK_MACHINE = MACHINE.with_(name=f"{MACHINE.name}_v3", order="spatial", chunks=True, records="compact")
"""The configuration that plays frames of models in chunks."""


@dataclass(frozen=True)
class InChunks:
    """A frame of a model in chunks, seen from the origin.

    Attributes:
        model: the model.
        chunks: the number of its chunks.
        read: the number of chunks that must be read.
        drawn: the number of splats that must be seen.
        change: a change of the model's words; None: none.
    """

    model: GaussianModel
    chunks: int
    read: int
    drawn: int
    change: Callable[[GaussianWords], GaussianWords] | None = None

    @property
    def frames(self) -> tuple[Frame, Frame]:
        """The frame of the integer renderer, and the same frame without the chunk test."""
        words = quantise_model(CHUNK_MACHINE, self.model)
        words = self.change(words) if self.change else words
        camera = view()
        flat = no_foveation(Display(camera.width, camera.height))
        registers = frame_registers(CHUNK_MACHINE, camera, words, flat, np.array([0.25, 0.5, 0.75]))
        return (render_frame(CHUNK_MACHINE, words, registers),
                render_frame(CHUNK_MACHINE, replace(words, chunks=None), registers))

    def check(self, name: str) -> Frame:
        """The frame; CaseFailure where it is not the one without the chunk test, or other chunks are read than must be."""
        frame, whole = self.frames
        require(np.array_equal(frame.entries.splat, whole.entries.splat), f"{name}: every intersection must stay")
        require(np.array_equal(frame.image, whole.image), f"{name}: every pixel must stay")
        found = {"chunks": len(frame.words.chunks), "read": frame.chunks_read, "drawn": len(np.unique(frame.entries.splat))}
        for what, value in found.items():
            require(value == getattr(self, what), f"{name}: {what} must be {getattr(self, what)}, not {value}")
        return frame


def _row(count: int, *place: float, gap: float = 0.01) -> list[tuple[float, float, float]]:
    """`count` places in a row along y that begins at a place."""
    x, y, z = place
    return [(x, y + i * gap, z) for i in range(count)]


def _giants() -> Mapping[str, InChunks]:
    """Among 64 splats far to the right, five that reach into the frame; equally far to the left, only small ones."""
    right, left = _row(CHUNK, 60.0, 1.0, 3.0), _row(CHUNK, -60.0, -2.0, 3.0)
    scale = np.full((2 * CHUNK, 3), 0.2)
    scale[10:15] = 25.0
    return {"far": InChunks(splats(*right, *left, scale=scale), 2, 1, 5)}


def _straddling() -> Mapping[str, InChunks]:
    """64 splats from behind the camera to before it, of which the 30 beyond the near plane are seen; 64 behind the camera."""
    around = [(0.0, 0.0, 0.1 * (i - 32) + 0.05) for i in range(CHUNK)]
    return {"around": InChunks(splats(*around, *_row(CHUNK, 0.0, 0.0, -30.0, gap=0.1), scale=0.002), 2, 1, 30)}


def _with_an_empty_chunk(words: GaussianWords) -> GaussianWords:
    """The words with a second header like the first one, but without Gaussians."""
    chunks = np.repeat(words.chunks[:1], 2)
    chunks["count"][0] = 0
    return replace(words, chunks=chunks)


def _empty() -> Mapping[str, InChunks]:
    return {"model": InChunks(splats(opacity=0.0), 0, 0, 0),
            "chunk": InChunks(splats(*_row(7, 0, 0, 3)), 2, 1, 7, _with_an_empty_chunk)}


def _single() -> Mapping[str, InChunks]:
    """One splat; a full chunk and one more; many at one place, whose box has no size."""
    return {"alone": InChunks(splats((0, 0, 3)), 1, 1, 1),
            "and one": InChunks(splats(*_row(CHUNK + 1, 0, 0, 3)), 2, 2, CHUNK + 1),
            "one place": InChunks(splats(*((0.1, 0.2, 3),) * 70), 2, 2, 70),
            "one, behind": InChunks(splats((0, 0, -3)), 1, 0, 0)}


def _broken() -> Mapping[str, InChunks]:
    """Of 65 splats the loader drops one, whose position is not a number, so that one full chunk is left."""
    model = splats(*_row(CHUNK + 1, 0, 0, 3))
    means = model.means.copy()
    means[10, 1] = np.nan
    left = loaded(columns_of(replace(model, means=means)))
    require(len(left) == CHUNK and sum(left.dropped.values()) == 1, f"the loader must drop one splat, not {left.dropped}")
    return {"dropped": InChunks(left, 1, 1, CHUNK)}


def _with_lies(words: GaussianWords) -> GaussianWords:
    """The words with three more headers like the first one, which name Gaussians that the model or a chunk does not have."""
    lies = np.repeat(words.chunks[:1], 3)
    lies["first"], lies["count"] = (0, len(words.geometry) - 5, (1 << INDEX_BITS) - 1), (CHUNK + 1, 6, 1)
    return replace(words, chunks=np.concatenate([lies[:2], words.chunks, lies[2:]]))


def _lying() -> Mapping[str, InChunks]:
    return {"headers": InChunks(splats(*_row(CHUNK + 30, 0, 0, 3)), 5, 2, CHUNK + 30, _with_lies)}


def _case(number: int, name: str, what: str, expected: str, frames: Callable[[], Mapping[str, InChunks]]) -> Case:
    """A case of frames in chunks: all its checks are on the integer renderer and the machine."""
    def check() -> None:
        for label, frame in frames().items():
            frame.check(label)

    return Case(number, name, what, expected, checks={"golden": check}, chunks=frames,
                absent={"oracle": "it reads no chunks", "gradient": "it reads no chunks"})


GIANT_IN_A_FAR_CHUNK = _case(
    59, "giant-in-a-far-chunk", "a chunk far beside the frame with five splats that reach into it, and one without",
    "the first chunk is read and the giants are drawn, the other is skipped", _giants)
CHUNK_AROUND_THE_CAMERA = _case(
    60, "chunk-around-the-camera", "a chunk from 3.15 behind the camera to 3.15 before it, and one behind",
    "the first is read, and what lies beyond the near plane is drawn; the other is skipped", _straddling)
EMPTY_CHUNK = _case(
    61, "empty-chunk", "a model without points; a header of a chunk without points",
    "a frame of background; the empty chunk is skipped, and its neighbour drawn", _empty)
CHUNK_OF_ONE = _case(
    62, "chunk-of-one", "one splat, 65 splats, 70 splats at one place, one splat behind the camera",
    "chunks of one are read like others, and boxes without a size hold their splats", _single)
NAN_IN_A_CHUNK = _case(
    63, "nan-in-a-chunk", "65 splats of which one is not a number", "the loader drops it, and one full chunk is left", _broken)

LYING_CHUNK = _case(
    77, "lying-chunk", "headers of chunks with more splats than a chunk has, or beyond the model's last one",
    "they are skipped, and nothing is read outside the model; the other two chunks are drawn", _lying)

CASES = (GIANT_IN_A_FAR_CHUNK, CHUNK_AROUND_THE_CAMERA, EMPTY_CHUNK, CHUNK_OF_ONE, NAN_IN_A_CHUNK, LYING_CHUNK)
