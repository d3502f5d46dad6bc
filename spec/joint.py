"""Joint frames: both eyes of a rectified pair from one set of lists, on a machine with super-tiles.

Both eyes are rendered; `spec.joint_warp` says what changes where the target is warped. Every Gaussian is read once, every pair
is sorted once and its record is gathered once; projection, tile test, colour and pixels are those of each eye. The eyes are the
*source*, number 0, and the *target*, number 1 (docs/stereo.md). What is not said here is as in frames of one eye
(`spec.supertiles`).

**Grids.** The tiles of each eye are numbered as in a frame of its own. A joint super-tile is a block of SUPER_X by SUPER_Y
tiles of the source and one of the target, which show about the same points: the setting `shift` is the distance in tiles,
along x, by which the points of the source lie further right in the target; negative where they lie further left. With O[0] =
max(shift, 0) and O[1] = max(-shift, 0), tile (x, y) of eye e lies in column (x + O[e]) / SUPER_X and row y / SUPER_Y of the
super-tiles, rounded down, at the place SUPER_X (y mod SUPER_Y) + (x + O[e]) mod SUPER_X. There are as many columns as the eye
with the larger O needs. Super-tiles are numbered row by row. Any shift gives the same pixels; the host takes the median
disparity, in whole tiles (`golden.host.joint_registers.median_shift`), so that most points lie in the same super-tile in both
eyes.

**What is read.** A chunk is read where the chunk test of either eye, each with its own settings and level bounds, says so.

**Culling and order.** The near test of the source, with the source's z, culls a Gaussian in both eyes, and the opacity test is
the same in both. The depth key, too, is computed from the source's z, for all Gaussians, also where they lie outside the
source's frame. So a pair has one key, and both eyes have one order. The target's own z decides about its pixels: mean, ellipse
and depth of each eye are those of a frame of its own. The target's near test, with the target's z, takes the Gaussian out of
the target alone, so that no projection divides by a z that is not positive. z is the same number in both eyes but for its
rounding. A Gaussian is outside where it touches the frame of neither eye.

**Pairs.** A Gaussian and a super-tile are a pair if the Gaussian has an intersection with a tile of the super-tile in either
eye. Lists, depth buckets, bounds, groups and the sort are those of frames of one eye.

**Second phase.** The record of a pair is read and decoded once, and projected and tested twice, which gives a mask of tiles
for each eye; one of the two can be 0. The pair has a BatchPlace for every level among the tiles of the source's mask, lowest
level first, and then for every level among those of the target's mask. A batch ends with a pair after which fewer than EYES
MAX_LEVELS places are free, or with the super-tile's last pair. In each batch the source's tiles are visited in the order of
their places, then the target's; all tiles of both eyes have a state of their own.

**Colours.** With the setting `shared_colour` at 0, harmonics are evaluated for the direction from each eye's camera. At 1,
they are evaluated once for a pair, for the direction from the source's camera, and both eyes have these colours.

**Pixels.** The source's pixels are those of a frame of one eye, bit for bit: its keys are its own, and of Gaussians that are
read for the target alone none has an intersection. A tile of the target differs from that of a frame of one eye only if two
Gaussians that meet in one of its pixels have another order by the source's keys, if a Gaussian is in front of the near plane
of one eye and not of the other, or with `shared_colour`.

**Counters.** `points`, those culled by the near plane and by opacity, `survivors`, `chunks_read` and `chunks_skipped` count
Gaussians and chunks, once for both eyes; `outside` those that touch neither frame. `entries`, `filtered`, `ops`, `skipped`,
tiles and visits are sums over both eyes, and so are saturations, each of which is counted for every projection or place that
has it. `pairs`, `header_hits`, `header_misses`, `batches` and `groups` count what there is once for both eyes.

**Refused.** A machine whose lists belong to tiles; it renders two eyes by warping. A frame with more joint super-tiles than the
machine has lists: a shift can take one column more than a frame of one eye. A shift beyond SHIFT_MOST. The RTL of machines with
`config.joint` renders joint frames; the integer renderer and the cycle model do so for every machine with super-tiles.
"""

from __future__ import annotations

from spec.config import AcceleratorConfig
from spec.constants import SUPER_X, SUPER_Y
from spec.errors import InputError
from spec.records import Field, Record, frame_lists, gaussian_point, splat_eye

EYES = 2
"""Eyes of a joint frame: the source, number 0, and the target, number 1."""

SHIFT_MOST = SUPER_X
"""Largest magnitude of `shift`, with which a frame has at most one column of super-tiles more than a frame of one eye."""


def grid_origins(shift: int) -> tuple[int, int]:
    """The O of source and target: columns of tiles by which the eye's frame lies right of the first super-tile's left edge.

    Raises:
        ValueError: the shift is not in -SHIFT_MOST..SHIFT_MOST.
    """
    if not -SHIFT_MOST <= shift <= SHIFT_MOST:
        raise ValueError(f"shift must be in {-SHIFT_MOST}..{SHIFT_MOST}, not {shift!r}")
    return max(shift, 0), max(-shift, 0)


def joint_columns(tiles_x: int, shift: int) -> int:
    """Columns of joint super-tiles in a frame with so many columns of tiles."""
    return -(-(tiles_x + abs(shift)) // SUPER_X)


def check_joint(config: AcceleratorConfig, tiles_x: int, tiles_y: int, shift: int) -> None:
    """Raises InputError where the machine cannot render a joint frame of so many tiles."""
    if not config.supertiles:
        raise InputError(f"joint frames of two eyes are not accepted: config {config.name!r} has lists by tile; it warps the "
                         "second eye")
    count = joint_columns(tiles_x, shift) * -(-tiles_y // SUPER_Y)
    if count > frame_lists(config):
        raise InputError(f"two eyes of {tiles_x}x{tiles_y} tiles with a shift of {shift} are not accepted: they have {count} "
                         f"super-tiles, and config {config.name!r} has {frame_lists(config)} lists")


def eye_point(config: AcceleratorConfig) -> Record:
    """A Gaussian on its way into projection in a machine with joint frames: once for each eye."""
    return Record("EyePoint", eye_point.__doc__, (
        *gaussian_point(config).fields,
        Field("position", config.formats.view, "the eye's centre relative to the model's origin", 3), *splat_eye(config),
    ))
