"""The option `--levels-from`: where a model without trained levels gets them from."""

from __future__ import annotations

import argparse
import hashlib
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from tqdm import tqdm

from golden.scenes.files import atomic_output
from golden.scenes.levels import smfr_levels, spread_levels
from golden.scenes.model import GaussianModel
from spec.command_line import choice
from spec.errors import InputError
from spec.paths import cache_folder
from spec.sources import fingerprint, sources_of

ENHANCED, SPREAD, RANDOM = LEVELS_FROM = ("enhanced", "spread", "random")
"""The sources by name; the first is the default. Studies, reports and tests of cycles name RANDOM, so that their
numbers stay."""

KEPT = 8
"""Number of models whose fitted levels are kept."""


def add_levels_from(parser: argparse.ArgumentParser) -> None:
    """Adds `--levels-from`, which `leveled` reads."""
    parser.add_argument(
        "--levels-from", default=ENHANCED, metavar="|".join(LEVELS_FROM),
        help="levels of a model without trained ones: fitted to the model's own pictures (below a minute the first time, then "
             "kept), evenly spread subsets with raised opacity, or random subsets, the paper's SMFR (default: %(default)s)")


def leveled(model: GaussianModel, args: argparse.Namespace) -> tuple[GaussianModel, dict[str, object]]:
    """The model with the levels that a command line asks for, and what the record beside a picture says of their source.

    Args:
        model: a model; one that has levels, or of which no more than one is asked for, is returned as it is.
        args: `levels` (None: those of the model), `levels_from` (absent: the default) and `seed` are read.

    Raises:
        InputError: the source is not one of LEVELS_FROM.
    """
    source = choice("levels-from", getattr(args, "levels_from", ENHANCED), LEVELS_FROM)
    if args.levels is None or args.levels == 1 or model.levels > 1:
        return model, {}
    makers = {ENHANCED: kept_enhanced, SPREAD: lambda m, count, _: spread_levels(m, count), RANDOM: smfr_levels}
    return makers[source](model, args.levels, args.seed), {"levels_from": source}


def kept_enhanced(model: GaussianModel, levels: int, seed: int = 0, folder: Path | None = None) -> GaussianModel:
    """`golden.scenes.level_fit.enhanced_levels`, from the user's cache folder if they were made before.

    Args:
        model: its level 1 is used.
        levels: number of levels, 2..4.
        seed: see `enhanced_levels`.
        folder: the folder in which levels are kept; the user's cache folder by default.
    """
    from golden.scenes.level_fit import enhanced_levels  # its kernels need numba, which is slow to import

    folder = folder or cache_folder("levels")
    arrays = (model.means, model.log_scales, model.quats, model.opacity[:, 0], model.sh_dc[:, 0], model.sh_rest, model.up)
    content = [hashlib.sha256(np.ascontiguousarray(array)).hexdigest() for array in arrays]
    key = fingerprint(sources_of("golden.scenes.level_fit"), levels, seed, content)
    path = folder / f"{key}.npz"
    found = _load(path, model, levels)
    if found is None:
        with tqdm(desc=f"fitting {levels} levels to {model.name}", unit="step", file=sys.stderr) as bar:
            def progress(done: int, steps: int) -> None:
                bar.total = steps
                bar.update(done - bar.n)

            found = enhanced_levels(model, levels, seed, progress)
        with suppress(OSError, InputError):  # a full disk or a folder that cannot be written costs time but no result
            _save(path, found)
    return found


def _save(path: Path, model: GaussianModel) -> None:
    """Keeps what fitting made; of the files in the folder, only those used last stay."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.flatnonzero(model.quality_bound > 1)
    with atomic_output(path) as file:
        np.savez(file, bound=model.quality_bound, opacity=model.opacity[rows, 1:], dc=model.sh_dc[rows, 1:])
    for old in sorted(path.parent.glob("*.npz"), key=lambda other: other.stat().st_mtime)[:-KEPT]:
        old.unlink(missing_ok=True)


def _load(path: Path, model: GaussianModel, levels: int) -> GaussianModel | None:
    """The model with the levels that `_save` kept; None if there are none or the file is broken."""
    try:
        with np.load(path) as file:
            bound, made = file["bound"], {"opacity": file["opacity"], "sh_dc": file["dc"]}
            arrays = {name: np.repeat(getattr(model, name)[:, :1], levels, axis=1) for name in made}
            for name, values in made.items():
                arrays[name][bound > 1, 1:] = values
            path.touch()
            return replace(model, quality_bound=bound, **arrays)
    except (OSError, ValueError, KeyError, IndexError, EOFError, BadZipFile):
        return None
