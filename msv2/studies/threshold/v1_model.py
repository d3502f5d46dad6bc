"""The predecessor's model (v1-H) beside a finished run of `golden/train.py`: its L1, levels without opacity enhancement.

What the threshold of warping is chosen by (paper section 6.4, `MetaSapiens-H`). The chain is the run's own up to L1; only
levels 2 to 4 are trained, as `msv2/studies/training/study.py` trains them for its ablation.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from golden.scenes.files import read_json
from golden.scenes.request import make_folder
from golden.scenes.save import save_model
from golden.training.chain import Chain
from golden.training.recipe import RESULTS
from msv2.studies.training.table_runs import LEVELS, PLAIN, part_plan
from msv2.studies.training.tables import Wanted, prepare
from spec.errors import InputError

SUFFIX = "-v1"
"""Of the folder that `golden/train.py --no-opacity-enhancement` writes, after the name of the scene."""


def beside(model: Path) -> Path:
    """Where the v1 model of a run's model.ply is looked for: RUN-v1/model.ply."""
    return model.parent.with_name(model.parent.name + SUFFIX) / model.name


def train_v1(model: Path, work: Path, device: str = "cpu") -> Path:
    """The v1 model of a run, trained where it is not there yet; an interrupted chain goes on.

    Args:
        model: model.ply in the folder of a finished run.
        work: for checkpoints, in a folder a run.
        device: where to train.

    Raises:
        InputError: no finished run is there, or its checkpoints are gone.
        Interrupted: after SIGINT; the same call goes on.
    """
    out = beside(model)
    if out.exists():
        return out
    options = read_json(model.parent / "report.json")["options"]
    wanted = Wanted(options["scene"], {name.replace("-", "_"): options[name]
                                       for name in ("variant", "size", "iterations", "max-points", "seed")})
    prepared = prepare(wanted, model.parent.parent, device)
    if not prepared.ready:
        raise InputError(f"{model.parent}: has no checkpoint of a finished run; v1's levels start from its L1")
    key = hashlib.sha256(json.dumps(prepared.options, sort_keys=True).encode()).hexdigest()[:8]
    folder = make_folder(work / f"{prepared.scene.name}-{key}")
    chain = Chain(part_plan("plain", prepared.recipe, prepared.scene, device, dict(prepared.ready)), folder,
                  prepared.options | {"part": "plain"}, resume=any((folder / "checkpoints").glob("iteration_*.pt")),
                  classes=RESULTS)
    levels = chain.run()[LEVELS[-1] + PLAIN]
    make_folder(out.parent)
    save_model(levels.to_model(up=prepared.scene.up, name=f"{prepared.scene.name}{SUFFIX}"), out)
    return out
