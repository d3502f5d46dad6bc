"""Seeded faults in the renderers: each removes a guard, and a case must then fail.

Some guards are compiled by numba. They are removed where Python passes constants to the compiled code.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from unittest import mock

import numpy as np

from golden.host import compact
from golden.msv2_ref import array, array_kernel, batches, chunk_test, pipeline, projection, tile_merge, warp
from golden.oracle import project as oracle_project
from golden.scenes.model import GaussianModel
from msv2.cases.check import Cell, cell
from msv2.cases.registry import case_named
from spec.chunks import SCALE_TOP_STEPS
from spec.constants import SH_C0
from spec.formats import Fixed, Rounding

_INTERVALS, _ENCODE_QUATERNION, _ENCODE_DC = chunk_test._intervals, compact._encode_quaternion, compact._encode_dc


@dataclass(frozen=True)
class Fault:
    """A seeded fault, that is, a guard removed.

    Attributes:
        name: the name of the fault.
        column: the renderer whose guard it is: oracle, golden, gradient or rtl.
        case: id or name of the case that must fail.
        drop: makes a context in which the guard is absent.
    """

    name: str
    column: str
    case: str
    drop: Callable[[], AbstractContextManager]


def replaced(*changes: tuple[str, object]) -> Callable[[], AbstractContextManager]:
    """A context in which each named attribute is replaced."""
    def context() -> AbstractContextManager:
        stack = ExitStack()
        for name, value in changes:
            stack.enter_context(mock.patch(name, value))
        return stack
    return context


def _culling(**changes: object) -> Callable[[], AbstractContextManager]:
    """A context with other constants in the projection unit's kernels."""
    original = projection.culling_constants
    return replaced(("golden.msv2_ref.projection.culling_constants", lambda config: original(config)._replace(**changes)))


def _array(**changes: object) -> Callable[[], AbstractContextManager]:
    """A context with other constants in the array's kernels."""
    original = array_kernel.array_constants
    return replaced(("golden.msv2_ref.array_kernel.array_constants", lambda config: original(config)._replace(**changes)))


def _registers(**changes: object) -> Callable[[], AbstractContextManager]:
    """A context with other frame registers."""
    original = pipeline.frame_registers
    return replaced(("golden.msv2_ref.pipeline.frame_registers", lambda *asked: replace(original(*asked), **changes)))


def _wrapping(self: Fixed, x: np.ndarray | float, rounding: Rounding = Rounding.HALF_UP) -> np.ndarray:
    """A `Fixed.quantise` that wraps where it must saturate."""
    raw = np.floor(np.ldexp(np.clip(np.asarray(x, float), -(2.0**40), 2.0**40), self.frac_bits) + 0.5).astype(np.int64)
    return self.from_bits(self.to_bits(raw))


def _sides_swapped(*asked: object) -> tuple[np.ndarray, np.ndarray]:
    low, high = _INTERVALS(*asked)
    return high, low


def _unsigned_quaternion(quat: np.ndarray, coarse: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """As the encoder, but for the sign of the codes where the largest component is negative."""
    largest, code, clipped = _ENCODE_QUATERNION(quat, coarse)
    negative = quat[np.arange(len(quat)), largest] < 0
    return largest, np.where(negative[:, None], -1 - code, code), clipped


def _smallest_range(dc: np.ndarray, coarse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As the encoder, but colours beyond the smallest range are clipped to it."""
    return _ENCODE_DC(np.clip(dc, -1024, 3000), coarse)


def _ties_by_arrival(depth_key: np.ndarray, visible: np.ndarray) -> np.ndarray:
    rows = np.flatnonzero(visible).astype(np.int32)[::-1]
    return rows[np.argsort(depth_key[rows], kind="stable")]


def _groups_without_end(counts: np.ndarray, tiles_x: int, beta: int) -> np.ndarray:
    return 2 * _merge(counts, tiles_x, beta)


_visits, _batches = array.render_visits, batches.cut_batches
_merge, _disparity, _colours, _oracle_colours, _select = (
    tile_merge.merge_tiles, warp.raw_disparity, pipeline.splat_colours, oracle_project.colour_per_level,
    GaussianModel.select)


def _wrapping_counters(hits: np.ndarray, tiles: int, count_bits: int) -> tuple[np.ndarray, bool, bool]:
    return np.bincount(hits[hits < tiles], minlength=tiles) % (1 << count_bits), False, False


def _always_fresh(config, visits: np.ndarray, entries: np.ndarray, background: np.ndarray) -> array.Pixels:
    visits["fresh"] = 1
    return _visits(config, visits, entries, background)


def _no_empty_batches(start: np.ndarray, places: np.ndarray, batch_places: int, *most: int) -> batches.Batches:
    of = _batches(start, places, batch_places, *most)
    kept = np.diff(of.start) > 0
    return batches.Batches(of.supertile[kept], np.append(of.start[:-1][kept], of.start[-1]), of.final[kept])


def _no_depth_of_zero(config, transmittance: np.ndarray, depth: np.ndarray, scale: int) -> np.ndarray:
    return np.where(depth > 0, _disparity(config, transmittance, depth, scale), 0)


def _last_wins(x: np.ndarray, key: np.ndarray, keep: np.ndarray, source: np.ndarray) -> None:
    for row, column in np.argwhere(keep == 1):
        source[row, x[row, column]] = column if source[row, x[row, column]] < 0 else source[row, x[row, column]]


def _clamped_first(config, words, registers, rows: np.ndarray) -> np.ndarray:
    colour = words.colour.copy()
    colour["dc"] = np.maximum(colour["dc"], 0)
    return _colours(config, replace(words, colour=colour), registers, rows)


def _oracle_clamped_first(model: GaussianModel, index: np.ndarray, eye: np.ndarray) -> np.ndarray:
    return _oracle_colours(replace(model, sh_dc=np.maximum(model.sh_dc, -0.5 / SH_C0)), index, eye)


def _without_colours(self: GaussianModel, index: np.ndarray) -> GaussianModel:
    model = _select(self, index)
    return replace(model, sh_dc=self.sh_dc[: len(model)])


def _unclipped_logit(opacity: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.log(opacity) - np.log1p(-opacity)


_ALL = "golden.scenes.clean._usable", lambda fields: (np.ones(len(fields.means), bool), {})
_WIDE = np.array([-1e30, 1e30, -1e30, 1e30])

FAULTS = (
    Fault("no near plane", "golden", "point-at-the-camera", _registers(near=-1e30)),
    Fault("near plane closed on the wrong side", "golden", "near-plane-ulp", _registers(near=0.25 - 2.0**-21)),
    Fault("no clamp of the Jacobian", "golden", "needle-at-the-frustum", _registers(limits=_WIDE)),
    Fault("no guard band", "golden", "veil-beyond-the-range", _culling(band_low=-1e30, band_high=1e30)),
    Fault("no low-pass filter", "golden", "degenerate-axes", _culling(low_pass=0.0)),
    Fault("no cull of the faint", "golden", "opacity-below-the-cut", _culling(faintest=-(1 << 20))),
    Fault("no cut at 1/255 in the array", "golden", "opacity-below-the-cut", _array(cut_min=-(1 << 20))),
    Fault("no bound of the support", "golden", "amplified-by-128", _array(support=1 << 20)),
    Fault("no alpha_max at level 1", "golden", "opaque-against-the-stop", _array(alpha_max_l1=1 << 12)),
    Fault("pixels stop a hundred times too early", "golden", "opaque-against-the-stop", _array(t_stop=400)),
    Fault("numbers wrap where they must saturate", "golden", "colour-above-one",
          replaced(("spec.formats.Fixed.quantise", _wrapping))),
    Fault("depth keys do not saturate", "golden", "key-inversions", _culling(key_max=1 << 30)),
    Fault("ties by arrival, not by index", "golden", "equal-depths",
          replaced(("golden.msv2_ref.sort.depth_order", _ties_by_arrival))),
    Fault("group ids with gaps", "golden", "merge-thresholds",
          replaced(("golden.msv2_ref.tile_merge.merge_tiles", _groups_without_end))),
    Fault("no origin among the points", "golden", "planetary-coordinates",
          replaced(("numpy.median", lambda values, axis=None: np.zeros(3)))),
    Fault("no gap allowed before an outlier's depth", "golden", "far-outlier",
          replaced(("golden.host.registers.DEPTH_GAP", 1e30))),
    Fault("quaternions as they come", "golden", "quaternions-of-any-length",
          replaced(("numpy.linalg.norm", lambda values, axis=None, keepdims=False: np.ones((len(values), 1))))),
    Fault("colours clamped before the sum", "golden", "negative-colour-sum",
          replaced(("golden.msv2_ref.pipeline.splat_colours", _clamped_first))),
    Fault("tile counters wrap", "golden", "more-than-an-index",
          replaced(("golden.msv2_ref.tile_merge.count_tiles", _wrapping_counters))),
    Fault("a depth of 0 has no disparity", "golden", "beyond-the-row",
          replaced(("golden.msv2_ref.warp.raw_disparity", _no_depth_of_zero))),
    Fault("the first of many wins", "golden", "many-onto-one", replaced(("golden.msv2_ref.warp._scatter", _last_wins))),
    Fault("broken rows are kept", "golden", "nan-position", replaced(_ALL)),
    Fault("infinite rows are kept", "golden", "infinite-fields", replaced(_ALL)),
    Fault("zero rotations are kept", "golden", "zero-quaternion", replaced(_ALL)),
    Fault("the chunk test forgets the splats' sizes", "golden", "giant-in-a-far-chunk",
          replaced(("golden.msv2_ref.chunk_test.sigma_significands", lambda config: (0,) * SCALE_TOP_STEPS))),
    Fault("the chunk test takes the near side for the far one", "golden", "chunk-around-the-camera",
          replaced(("golden.msv2_ref.chunk_test._intervals", _sides_swapped))),
    Fault("a far splat coarsens the grid of near ones", "golden", "far-splat-beside-near-ones",
          replaced(("golden.host.chunks.FINE_STEPS", 2.0**-100))),
    Fault("giants share a chunk with small splats", "golden", "sizes-of-24-octaves",
          replaced(("golden.host.chunks.SIZE_SPAN", 1 << 20))),
    Fault("the largest component of a quaternion keeps its sign", "golden", "equal-quaternion-components",
          replaced(("golden.host.compact._encode_quaternion", _unsigned_quaternion))),
    Fault("all base colours take the smallest range", "golden", "ranges-of-colours-and-opacities",
          replaced(("golden.host.compact._encode_dc", _smallest_range))),
    Fault("the model keeps the order of its file", "golden", "shuffled-coincident-points",
          replaced(("golden.host.quantise.memory_order", lambda config, geometry, *_: np.arange(len(geometry))))),
    Fault("a tile's state starts anew in every batch", "golden", "one-bank-stopped",
          replaced(("msv2.cases.supertiles.render_visits", _always_fresh))),
    Fault("super-tiles without pairs have no batch", "golden", "empty-super-tiles",
          replaced(("golden.msv2_ref.batches.cut_batches", _no_empty_batches))),
    Fault("colours are not filtered with the rest", "oracle", "fields-stay-aligned",
          replaced(("golden.scenes.model.GaussianModel.select", _without_colours))),
    Fault("nothing is not finite", "oracle", "nan-scale-or-rotation",
          replaced(("golden.oracle.project.finite_input", lambda model: np.ones(len(model), bool)))),
    Fault("no clamp of the Jacobian", "oracle", "needle-at-the-frustum",
          replaced(("golden.oracle.project.FRUSTUM_MARGIN", 1e30))),
    Fault("no guard band", "oracle", "veil-beyond-the-range",
          replaced(("golden.oracle.project.within", lambda mean2d, mean_range: np.ones(len(mean2d), bool)))),
    Fault("no low-pass filter", "oracle", "degenerate-axes", replaced(("golden.oracle.project.LOW_PASS", 0.0))),
    Fault("no cut at 1/255", "oracle", "opacity-below-the-cut", replaced(("golden.oracle.project.ALPHA_MIN", 1e-9))),
    Fault("colours clamped before the sum", "oracle", "negative-colour-sum",
          replaced(("golden.oracle.project.colour_per_level", _oracle_clamped_first))),
    Fault("activated files pass", "oracle", "activated-already",
          replaced(("golden.scenes.ply.check_not_activated", lambda *fields: None))),
    Fault("logits of 1 without end", "oracle", "logit-of-one", replaced(("golden.scenes.save.logit", _unclipped_logit))),
    Fault("gazes off the screen pass", "oracle", "gaze-off-and-at-the-edge",
          replaced(("msv2.cases.eyes.check_gaze", lambda *gaze: None))),
    Fault("frames without coverage pass", "oracle", "no-coverage-fails",
          replaced(("msv2.cases.self_check.check_shots", lambda case, renderer, see: None))),
)
"""The faults of the oracle, the integer renderer and the loader."""


def caught(fault: Fault) -> tuple[bool, str]:
    """Whether the fault makes its case fail, and the failure's message, or why the fault proves nothing."""
    case = case_named(fault.case)
    with fault.drop(), np.errstate(all="ignore"):
        got = cell(case, fault.column)
    return told(got), got.words or f"{case.id} does not notice"


def told(got: Cell) -> bool:
    """Whether a case failed by its own expectation. A crash does not count, as the fault itself may have caused it."""
    return got.outcome == "FAIL" and not got.crashed
