"""The predecessor's model (v1-H) for a finished run of `golden/train.py`: the run's L1, and levels without opacity enhancement.

The threshold of warping is chosen by comparison with it (paper section 6.4, `MetaSapiens-H`). Training is the run's own up to
L1; only levels 2 to 4 are trained anew, as `msv2/studies/training/study.py` trains them for its ablation.
"""

from __future__ import annotations

import sys
from pathlib import Path

from golden.scenes.files import read_json
from golden.scenes.request import make_folder
from golden.scenes.save import save_model
from msv2.studies.training.tables import Wanted, prepare, train_scene
from spec.errors import InputError

SUFFIX = "-v1"
"""The suffix that `golden/train.py --no-opacity-enhancement` adds to a scene's name for its folder."""


def beside(model: Path) -> Path:
    """The path at which the v1 model of a run's model.ply is expected: RUN-v1/model.ply."""
    return model.parent.with_name(model.parent.name + SUFFIX) / model.name


def train_v1(model: Path, work: Path, device: str = "cpu") -> Path:
    """The path of a run's v1 model, which is trained if it does not exist. An interrupted training continues.

    Args:
        model: model.ply in the folder of a finished run.
        work: the folder for checkpoints, with one folder per run.
        device: the device on which to train.

    Raises:
        InputError: there is no finished run, or its checkpoints are gone.
        Interrupted: SIGINT was received; the same call continues the training.
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
    trained = train_scene(prepared, device, work, ["plain"], lambda text: print(text, file=sys.stderr))
    make_folder(out.parent)
    save_model(trained.plain.to_model(up=prepared.scene.up, name=f"{prepared.scene.name}{SUFFIX}"), out)
    return out
