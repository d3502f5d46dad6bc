"""Quantises a model into Gaussian words, the DRAM image: the records `gaussian_geometry` and `gaussian_colour` of
`spec.records`, in the order of `golden.host.order`, and for machines that read them chunks and compact records."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from golden.host import compact
from golden.host.chunks import cut_chunks, largest_scale, opacity_code_above, strongest
from golden.host.compact import CompactWords
from golden.host.order import SPATIAL, Candidate, memory_order
from golden.scenes.model import GaussianModel
from spec.config import AcceleratorConfig
from spec.constants import AMP_MAX, MAX_LEVELS, SH_C0
from spec.errors import InputError
from spec.records import INDEX_BITS, gaussian_colour, gaussian_geometry
from spec.supertiles import CHUNK_BITS


class DecodedGeometry(NamedTuple):
    """Geometry words as the projection kernels read them.

    Attributes:
        mean: (N, 3) float64, relative to the words' origin.
        scale: (N, 3) float64.
        quat: (N, 4) int32 raw quaternions, rounded to numbers that the `work` format can represent, as the projection unit
            does.
        opacity: (N,) int32, the largest raw `log2_opacity` among the levels that use the point.
    """

    mean: np.ndarray
    scale: np.ndarray
    quat: np.ndarray
    opacity: np.ndarray


@dataclass(frozen=True)
class GaussianWords:
    """The DRAM image of a model: what the machine reads of the Gaussians.

    Attributes:
        config: the machine whose formats the words have.
        geometry: (N,) records of `gaussian_geometry`'s dtype, in their order in memory; with compact records what these stand
            for.
        colour: (N,) records of `gaussian_colour`'s dtype at `sh_degree`, likewise.
        origin: (3,) float64, world position that the words' coordinates are relative to; the host subtracts it from the
            camera's position.
        levels: number of foveation levels in use, 1..4.
        sh_degree: 0..3.
        saturated: number of values that were clipped to their format, by field.
        model_index: (N,) int64, the model's own index of every Gaussian; None where it is the same.
        chunks: (C,) records of `chunk_header`'s dtype; None for machines without chunks.
        compact: the records that lie in memory; None for machines with wide ones.
    """

    config: AcceleratorConfig
    geometry: np.ndarray
    colour: np.ndarray
    origin: np.ndarray
    levels: int
    sh_degree: int
    saturated: dict[str, int]
    model_index: np.ndarray | None = None
    chunks: np.ndarray | None = None
    compact: CompactWords | None = None

    def in_model(self, index: np.ndarray | int) -> np.ndarray:
        """int64: the model's own indices of Gaussians by their indices in memory (any shape)."""
        index = np.asarray(index, np.int64)
        return index if self.model_index is None else self.model_index[index]

    @cached_property
    def decoded(self) -> DecodedGeometry:
        """The geometry decoded into numbers; computed once for all frames."""
        n, g = self.config.formats, self.geometry
        quat = np.ascontiguousarray(g["quat"])
        if n.work.sig_bits < n.quaternion.width - 1:
            rounded = n.work.round(n.quaternion.to_float(quat))
            quat = np.ldexp(rounded, n.quaternion.frac_bits).astype(np.int32)  # may round up to 1, beyond the raw format
        return DecodedGeometry(
            n.position.to_float(g["mean"]), n.scale.to_float(g["scale"]), quat,
            strongest(self.config, g).astype(np.int32))


def quantise_model(config: AcceleratorConfig, model: GaussianModel, *, order: Candidate | None = None) -> GaussianWords:
    """Rounds every parameter into its memory format, and orders and packs the Gaussians as the machine reads them.

    The origin is the median of the points, so that coordinates of planetary size keep their precision. An opacity of 0 becomes
    the smallest number of the format, which the cut at alpha 1/255 removes. Levels that a model lacks repeat its last one. SH
    coefficients beyond the machine's degree are dropped.

    Args:
        config: the machine.
        model: the Gaussians.
        order: how to sort the Gaussians, where it is not as `config.order` says.

    Raises:
        InputError: there are more Gaussians than a Gaussian index, or the counter of a tile's intersections, can hold, or more
            chunks than the number of a chunk.
    """
    if len(model) >= 1 << INDEX_BITS:
        raise InputError(f"{len(model)} Gaussians are not accepted: {INDEX_BITS} bits of index take {(1 << INDEX_BITS) - 1}")
    if model.sh_degree > config.sh_degree:
        model = model.with_sh_degree(config.sh_degree)
    geometry, colour, origin, saturated = _wide_words(config, model)
    words = GaussianWords(config, geometry, colour, origin, model.levels, model.sh_degree, saturated)
    order = order or (SPATIAL if config.order == "spatial" else None)
    if order is not None:
        index = memory_order(config, geometry, colour, model.sh_degree, order)
        words = replace(words, geometry=geometry[index], colour=colour[index], model_index=index)
    return in_chunks(words) if config.chunks else words


def in_chunks(words: GaussianWords) -> GaussianWords:
    """The words cut into chunks, and packed where the machine's records are compact. Neither changes their order.

    Raises:
        InputError: there are more chunks than the number of a chunk can hold.
    """
    config = words.config
    chunks = cut_chunks(config, words.geometry)
    if config.supertiles and len(chunks) > 1 << CHUNK_BITS:
        raise InputError(f"{len(chunks)} chunks of Gaussians are not accepted: {CHUNK_BITS} bits of a chunk's number take "
                         f"{1 << CHUNK_BITS} in a machine with super-tiles")
    if not config.compact:
        return with_opacities(replace(words, chunks=chunks))
    packed, lost = compact.encode(config, chunks, words.geometry, words.colour, words.sh_degree)
    geometry, colour = compact.decode(config, chunks, packed, words.sh_degree)
    return with_opacities(replace(
        words, geometry=geometry, colour=colour, saturated=words.saturated | lost, chunks=chunks, compact=packed))


def with_opacities(words: GaussianWords) -> GaussianWords:
    """The words with the strongest opacity of their Gaussians in the headers of chunks."""
    chunks = words.chunks.copy()
    if len(chunks):
        codes = (opacity_code_above(words.config, strongest(words.config, words.geometry)) if words.compact is None
                 else words.compact.geometry["opacity"])
        chunks["opacity"] = np.maximum.reduceat(codes, chunks["first"])
    return replace(words, chunks=chunks)


def _wide_words(
    config: AcceleratorConfig, model: GaussianModel,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, int]]:
    """(geometry, colour, origin, saturated) as in `GaussianWords`, in the model's order."""
    n = config.formats
    geometry = np.zeros(len(model), gaussian_geometry(config).dtype)
    colour = np.zeros(len(model), gaussian_colour(config, model.sh_degree).dtype)
    origin = np.median(model.means, axis=0) if len(model) else np.zeros(3)

    level = np.minimum(np.arange(MAX_LEVELS), model.levels - 1)
    opacity = np.maximum(model.opacity, 2.0**-16)
    base = SH_C0 * model.sh_dc + 0.5
    rest = model.sh_rest.reshape(len(model), 3 * model.sh_rest.shape[1])  # reshape cannot infer -1 for an empty model
    norm = np.linalg.norm(model.quats, axis=1, keepdims=True)
    scale = np.exp(np.minimum(model.log_scales, 80.0))
    largest = largest_scale(config) if config.chunks else n.scale.max

    geometry["mean"] = n.position.quantise(model.means - origin)
    geometry["scale"] = n.scale.quantise(np.minimum(scale, largest))
    geometry["quat"] = n.quaternion.quantise(model.quats / np.where(norm > 0, norm, 1.0))
    geometry["log2_opacity"] = n.log2_opacity.quantise(np.log2(np.minimum(opacity, AMP_MAX)))[:, level]
    geometry["bound"] = model.quality_bound - 1
    colour["dc"] = n.sh_dc.quantise(base)[:, level].reshape(len(model), 3 * MAX_LEVELS)
    if model.sh_degree:
        colour["rest"] = n.sh_rest.quantise(rest)
    saturated = {
        "scale": int((scale > largest).sum()),
        "opacity": int((opacity > AMP_MAX).sum()),
        "dc": int((np.abs(base) > 2.0**n.sh_dc.int_bits).sum()),
        "rest": int((np.abs(rest) > 2.0**n.sh_rest.int_bits).sum()),
    }
    return geometry, colour, origin, saturated
