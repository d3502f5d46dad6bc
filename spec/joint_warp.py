"""Joint frames with a warped target: the tiles of the target that its table wants are rendered beside the source, the others
are warped from it, and those in which the warp leaves holes are rendered in a second sweep over the lists.

Machines with `config.joint` and `config.stereo` render such frames where the setting `stereo` is 1 beside `joint`. The
arithmetic of warping is that of frames with lists by tile (docs/stereo.md); what is not said here is as in joint frames
(`spec.joint`). A tile of the target is *known* if `warp` is 0 in its table: the host wants it rendered. A *hole tile* is one
that is not known and in which the warp leaves a hole.

**First phase.** It is that of any joint frame: chunks, culls, pairs, lists and bounds do not depend on what is warped, so that
every tile of the target can still be rendered from the lists.

**First sweep.** The second phase renders all tiles of the source and the known tiles of the target. The source's rows of pixels
also go to the warp unit, in the order of super-tiles. It has a ring of columns (docs/stereo.md, "The window") for even and
another one for odd rows of tiles, because two strips are in flight where super-tiles are two tiles high; the warped pixels are
those of row-major order. The warp unit writes no pixel of a known tile.

**Second sweep.** It begins when all warped pixels are in memory; all pairs of the first sweep have then been dealt. With the
setting `second_sweep` at 1, and where there are hole tiles, the lists are gone through once more, in order. Lists of
super-tiles without a hole tile count as empty. Every other list with pairs is a group of its own, whatever `beta` says; its
pairs are read, sorted and gathered again, and of the target the hole tiles are rendered over what was warped there. With the
setting at 0 the holes stay: all four bytes of their pixels are 0.

**Tiles that a sweep wants.** What `spec.joint` says of the tiles of a pair's masks, of levels, places and visits, holds for the
tiles that the sweep renders. A super-tile without such a tile has one empty batch without visits in the second sweep. A pair
without such a tile, in either eye, has a BatchPlace with `none`, which takes no place of the batch.

**Projected for one eye.** In the first sweep, the pairs of a super-tile without a known tile are projected for the source
alone; in the second sweep all pairs are projected for the target alone. With `shared_colour` and harmonics, however, the second
sweep projects them for both eyes, because the direction of their colours is the source's.

**Pixels.** The source's are those of the joint frame without warping, and so is every tile of the target that is rendered. All
others are those that warping the same source gives in a machine with lists by tile.

**Counters.** Those of the first phase are those of the joint frame. `header_hits`, `header_misses`, `batches`, `visits`, `ops`,
`skipped`, `spilled_entries`, `groups`, saturated colours and `pixels` are sums over both sweeps; the cache of headers keeps its
content between them. `pixels` counts what is rendered, not what is warped. `pairs_again` counts the pairs that the second sweep
reads, `target_tiles` the tiles of the target that are rendered, and `cycles_target` the cycles of the second sweep. `warped`,
`filled` and `invalid_tiles` count in known tiles, too.

**Refused.** A machine that packs frames or overlaps the phases of frames. A frame whose pixels are not DisplayPixels. `stereo`
without `joint`.
"""

from __future__ import annotations

from spec.config import AcceleratorConfig
from spec.errors import InputError

SWEEPS = 2
"""Sweeps over the lists of a joint frame with a warped target."""


def check_joint_warp(config: AcceleratorConfig) -> None:
    """Raises InputError where the machine cannot warp the target of a joint frame."""
    if not config.supertiles:
        raise InputError(f"a joint frame with a warped eye is not accepted: config {config.name!r} has lists by tile")
    if not config.warps_joint:
        raise InputError(f"a joint frame with a warped eye is not accepted: config {config.name!r} has no warp unit; config "
                         "'v3_eyes_warp' has one, and so does a machine with lists by super-tile, `joint=true` and "
                         "`stereo=true`")


def check_sweeps(config: object) -> None:
    """Raises TypeError or ValueError where a unit that only machines with two sweeps have is not for this one."""
    if not isinstance(config, AcceleratorConfig):
        raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
    if not config.warps_joint:
        raise ValueError(f"config must be a machine whose joint frames may have a warped eye, not {config.name!r}")
