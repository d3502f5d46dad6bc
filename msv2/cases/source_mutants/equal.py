"""Mutants of Python that compute the same, found by reading, each with the reason. They are judged all the same: one that is
noticed does not belong here."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import cache

from msv2.cases.source_mutants.draw import SourceMutant, mutated


@dataclass(frozen=True)
class Equal:
    """A mutant that computes the same.

    Attributes:
        path: the module's file, from the project's folder on.
        text: what the mutant's line, as `ast.unparse` writes it, has and the module's line does not.
        why: the reason.
    """

    path: str
    text: str
    why: str


_ANY_NEGATIVE = "numpy infers a dimension from any negative number"

EQUAL = (
    Equal("spec/chunks.py", "TESTED_CHUNKS = 9", "the depth of a queue, on which only cycles depend"),
    Equal("golden/host/chunks.py", "smallest = largest = -2", "only its sign is read"),
    Equal("golden/host/chunks.py", "(1 << OPACITY_BITS) - 2)", "codes of opacities up to 128, the largest, end at 479"),
    Equal("golden/host/chunks.py", "np.where(size > 1,", "the loop goes on to the same step from a smaller one"),
    Equal("golden/host/compact.py", "reshape(-2, 3 * MAX_LEVELS)", _ANY_NEGATIVE),
    Equal("golden/host/joint_registers.py", "warp.reshape(-2)", _ANY_NEGATIVE),
    Equal("golden/host/memory_image.py", "_FIRST_BEAT, _GUARD_BEATS = (3, 6)", "any gap between regions is as good"),
    Equal("golden/host/order.py", "-(-record.width * 64) * 8", "more words of zeros, which order nothing"),
    Equal("golden/host/quantise.py", "model.sh_degree >= config.sh_degree", "a model cut to its own degree stays as it is"),
    Equal("golden/host/quantise.py", "(scale >= largest)", "no float64 has the largest scale as its exponential"),
    Equal("golden/msv2_ref/array_kernel.py", "support=1 << 31", "either is beyond every falloff"),
    Equal("golden/msv2_ref/array_kernel.py", "work.use[work.start[visit]:work.start[visit - 1]]",
          "the compiled loop runs over `order` and reads the rows of `use` from the same place on"),
    Equal("golden/msv2_ref/array_kernel.py",
          "order, use, 1, level - 1, True, tile_x, tile_y, background, segments, k, pairs, next_state",
          "splats of visits have two levels, and level is 0: -1 is the last of them, as 1 is"),
    Equal("golden/msv2_ref/batches.py", "reshape(len(rows), -2)", _ANY_NEGATIVE),
    Equal("golden/msv2_ref/buckets.py", "bounds.key.max(initial=1)", "one bit more keeps super-tiles apart, too"),
    Equal("golden/msv2_ref/chunk_test.py", "np.where(lo[:, k] > 0, q1, q0)", "differs at 0 only, and 0 times either is 0"),
    Equal("golden/msv2_ref/chunk_test.py", "np.zeros((len(chunks), 3), np.int64)", "the third column is never read"),
    Equal("golden/msv2_ref/colour.py", "total[:] = 0.01",
          "all other summands are integers, and a hundredth of one does not reach the next rounding boundary"),
    Equal("golden/msv2_ref/fetch.py", "bits = 1", "differs for one set only, whose number is 0 in any case"),
    Equal("golden/msv2_ref/joint.py", "np.zeros(4)", "the background of a frame of which only a depth is read"),
    Equal("golden/msv2_ref/joint.py", "+(-camera.height // TILE)", "the frame's registers are checked again"),
    Equal("golden/msv2_ref/plan.py", "_NOT_YET = (-1.0, 0.01, 0.0)", "the plane is below 0 in all 16 columns of a tile"),
    Equal("golden/msv2_ref/supertiles.py", "max(ranked, 2)", "any factor above every rank gives the same order"),
    Equal("golden/msv2_ref/tile_lists.py", "pages.reshape(-2, WORDS)", _ANY_NEGATIVE),
    Equal("golden/msv2_ref/tile_lists.py", "pages.reshape(-2, WORDS // BEAT_ENTRIES)", _ANY_NEGATIVE),
    Equal("golden/msv2_ref/tile_test.py", "max(first, 0.01)", "a column is compared with whole columns, or rounded down"),
    Equal("golden/msv2_ref/tile_test.py", "1.01 if none", "it is above the last tile, 0, too, so no tile is visited"),
    Equal("golden/msv2_ref/warp.py", "key[row, column] >= key[row, old]", "pixels with equal keys never meet"),
)


@cache
def _unparsed(text: str) -> list[str]:
    return ast.unparse(ast.parse(text)).splitlines()


def changed_line(text: str, mutant: SourceMutant) -> tuple[str, str]:
    """The line of a module that a mutant changes, before and after, as `ast.unparse` writes it."""
    before, after = _unparsed(text), mutated(text, mutant).splitlines()
    (place,) = [n for n, (old, new) in enumerate(zip(before, after, strict=True)) if old != new]
    return before[place].strip(), after[place].strip()


def reason(text: str, mutant: SourceMutant) -> str:
    """Why a mutant of a module computes the same; empty where it is not known to."""
    old, new = changed_line(text, mutant)
    return next((one.why for one in EQUAL if one.path == mutant.path and one.text in new and one.text not in old), "")
