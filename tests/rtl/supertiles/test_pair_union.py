"""The union of both eyes' pairs in Amaranth's simulator, against sets."""

from __future__ import annotations

import random

import pytest

from rtl.supertiles.pair_union import PairUnion
from spec.config import TINY_EYES, TINY_V3
from spec.records import frame_supertiles
from spec.supertiles import supertile_pair
from tests.helpers.rtl_ports import cycles_of, play, words_of
from tests.helpers.rtl_streams import assert_rejected

RECORD = supertile_pair(TINY_EYES)
DEPTH = frame_supertiles(TINY_EYES)


def pairs_of(rng: random.Random, gaussians: int, supertiles: int) -> list[dict[str, int]]:
    """The pairs of some Gaussians: of the source, then of the target, each by super-tile; some eyes have none."""
    rows = []
    for index in range(gaussians):
        for eye in range(2):
            places = rng.sample(range(supertiles), min(rng.choice([0, 0, 1, 2, 5]), supertiles))
            rows += [{"index": index, "depth_key": rng.getrandbits(24), "supertile": place, "eye": eye, "end": 0}
                     for place in sorted(places)]
    return rows


def kept(rows: list[dict[str, int]]) -> list[dict[str, int]]:
    """The pairs of the source, and those of the target that the source lacks."""
    source = {(row["index"], row["supertile"]) for row in rows if not row["eye"] and not row["end"]}
    return [row for row in rows if not row["eye"] or (row["index"], row["supertile"]) not in source]


@pytest.mark.parametrize("share", [0.0, 0.6])
@pytest.mark.parametrize("supertiles", [1, 6, DEPTH])
def test_a_pair_of_both_eyes_passes_once(share, supertiles):
    rng = random.Random(supertiles)
    rows = [*pairs_of(rng, 60, supertiles), {"index": 0, "depth_key": 0, "supertile": 0, "eye": 0, "end": 1}]
    moves = play(PairUnion(TINY_EYES), {"pairs": [RECORD.pack(row) for row in rows]}, {"union": share},
                 DEPTH + 4 * len(rows) + 20, seed=1, pauses=share)
    assert words_of(moves, "union") == [RECORD.pack(row) for row in kept(rows)]
    assert len(kept(rows)) < len(rows) and sum(row["eye"] for row in kept(rows)) > 2


def test_what_a_frame_left_does_not_count_in_the_next():
    """The source has pairs in one frame, and the target alone has the same ones in the next, after `clear`."""
    rows = [{"index": n, "depth_key": 0, "supertile": n % DEPTH, "eye": 0, "end": 0} for n in range(2 * DEPTH)]
    again = [{**row, "eye": 1} for row in rows[DEPTH:]]
    words, over = [RECORD.pack(row) for row in (*rows, *again)], []
    dut = PairUnion(TINY_EYES)

    def each(ctx, cycle):
        over.append((ctx.get(dut.ready), ctx.get(dut.busy)))
        ctx.set(dut.clear, cycle == DEPTH + len(rows) - 1)  # with the frame's last pair

    moves = play(dut, {"pairs": words}, {"union": 0.0}, 3 * DEPTH + len(words) + 20, each=each)
    assert words_of(moves, "union") == words
    assert cycles_of(moves, "pairs")[len(rows)] == 2 * DEPTH + len(rows)
    assert [ready for ready, _ in over].index(1) == DEPTH and over[-1] == (1, 0) and any(busy for _, busy in over)


def test_a_pair_a_cycle():
    rows = pairs_of(random.Random(5), 80, 9)
    moves = play(PairUnion(TINY_EYES), {"pairs": [RECORD.pack(row) for row in rows]}, {"union": 0.0}, DEPTH + len(rows) + 20)
    taken, left = cycles_of(moves, "pairs"), cycles_of(moves, "union")
    assert taken == list(range(DEPTH, DEPTH + len(rows))) and left[-1] - taken[-1] <= 2 and left[0] - taken[0] == 2


def test_only_machines_with_joint_frames_have_it():
    assert_rejected(lambda: PairUnion(3), TypeError, 3)
    assert_rejected(lambda: PairUnion(TINY_V3), ValueError, "tiny_v3")
