"""The chain of stages: what is resumed equals what was never interrupted, and what fails keeps its last checkpoint."""

import errno
import io
import json
import os
import re
import signal
from contextlib import contextmanager

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.gaussians import Gaussians  # noqa: E402
from golden.training import chain as chain_module  # noqa: E402
from golden.training import checkpoint as checkpoint_module  # noqa: E402
from golden.training.chain import Chain, Interrupted, Planned, non_finite  # noqa: E402
from golden.training.checkpoint import Checkpoint, Checkpoints  # noqa: E402
from golden.training.failure import TrainingError, room_needed  # noqa: E402
from golden.training.progress import Progress  # noqa: E402
from golden.training.remaining import USUAL, Remaining, kind_of  # noqa: E402
from golden.training.stage import Stage  # noqa: E402
from spec.errors import InputError  # noqa: E402
from spec.progress import as_time  # noqa: E402

OPTIONS = {"scene": "test", "seed": 3}


def gaussians(n: int = 5) -> Gaussians:
    generator = torch.Generator().manual_seed(1)
    shapes = ((n, 3), (n, 3), (n, 4), (n,), (n,), (n, 3), (n, 3, 3))
    return Gaussians(*(torch.randn(shape, generator=generator) for shape in shapes))


class Noise(Stage):
    """Gradient descent of seeded noise on Gaussians; `hook` is called in each step, with the stage."""

    def __init__(self, name, start, total, hook=None):
        self.name, self.total, self.done = name, total, 0
        self.hook = hook or (lambda stage: None)
        self.gaussians = start.map(lambda t: t.requires_grad_())
        self.optimiser = torch.optim.Adam(list(self.gaussians.tensors().values()), lr=0.01, eps=1e-15)
        self.mean = np.zeros(3)

    def step(self):
        self.done += 1
        generator = torch.Generator().manual_seed(hash((len(self.name), self.done)))
        target = torch.randn(self.gaussians.means.shape, generator=generator)
        loss = ((self.gaussians.means * self.gaussians.log_scales - target) ** 2).mean()
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        self.mean = 0.9 * self.mean + self.gaussians.means.detach().numpy().mean(0)
        record = {"loss": float(loss.detach()), "points": len(self.gaussians), "psnr": 20 + self.done / 10, "view": 7}
        return record | (self.hook(self) or {})

    def state(self):
        return {"done": self.done, "gaussians": self.gaussians.detached(), "optimiser": self.optimiser.state_dict(),
                "mean": self.mean.copy()}

    def load(self, state):
        self.done, self.mean = state["done"], state["mean"]
        for name, tensor in self.gaussians.tensors().items():
            tensor.data.copy_(getattr(state["gaussians"], name))
        self.optimiser.load_state_dict(state["optimiser"])

    def result(self):
        return self.gaussians.detached()


def plan(hook=None, total=12):
    """Two stages; the second starts from what the first left, and trains it in place."""
    return [Planned("first", total, lambda results: Noise("first", gaussians(), total, hook)),
            Planned("second", total, lambda results: Noise("second", results["first"], total, hook))]


def run(folder, hook=None, resume=False, options=OPTIONS, seconds=1e9, stages=None):
    chain = Chain(stages or plan(hook), folder, options, resume=resume, checkpoint_seconds=seconds)
    return chain.run(), chain


def same(a: Gaussians, b: Gaussians) -> bool:
    return all(torch.equal(x, y) for x, y in zip(a.tensors().values(), b.tensors().values(), strict=True))


def log(folder):
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def without_time(records):
    return [{k: v for k, v in record.items() if k != "seconds"} for record in records]


def interrupt_at(name, done):
    return lambda stage: signal.raise_signal(signal.SIGINT) if (stage.name, stage.done) == (name, done) else None


@pytest.mark.parametrize(("name", "done"), [("first", 1), ("first", 7), ("first", 12), ("second", 1), ("second", 12)])
def test_interrupted_and_resumed_equals_uninterrupted(tmp_path, name, done):
    whole, _ = run(tmp_path / "whole")
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(Interrupted, match=f"iteration {done + 12 * (name == 'second')}, (in|after) {name}"):
        run(tmp_path / "parts", interrupt_at(name, done))
    assert signal.getsignal(signal.SIGINT) is before
    resumed, chain = run(tmp_path / "parts", resume=True)
    assert resumed.keys() == whole.keys() == {"first", "second"}
    assert all(same(resumed[key], whole[key]) for key in whole)
    assert not same(whole["first"], whole["second"])
    assert without_time(log(tmp_path / "parts")) == without_time(log(tmp_path / "whole"))
    assert [record["iteration"] for record in log(tmp_path / "whole")] == list(range(1, 25))
    assert chain.spent["first"]["iterations"] == chain.spent["second"]["iterations"] == 12


def test_checkpointing_changes_nothing_and_keeps_two(tmp_path):
    seldom, _ = run(tmp_path / "seldom")
    often, chain = run(tmp_path / "often", seconds=0.0)
    assert all(same(often[key], seldom[key]) for key in seldom)
    assert [path.name for path in chain.checkpoints.paths()] == ["iteration_000000024_01.pt", "iteration_000000024_02.pt"]


def test_a_crash_loses_no_more_than_what_came_after_the_checkpoint(tmp_path):
    def crash(stage):
        if stage.name == "second" and stage.done == 5:
            raise RuntimeError("power failure")

    whole, _ = run(tmp_path / "whole")
    with pytest.raises(RuntimeError, match="power failure"):
        run(tmp_path / "parts", crash)
    with open(tmp_path / "parts" / "log.jsonl", "a") as file:
        file.write('{"iteration": 17, "sta')
    assert len(log(tmp_path / "whole")) == 24
    resumed, _ = run(tmp_path / "parts", resume=True)
    assert same(resumed["second"], whole["second"])
    assert without_time(log(tmp_path / "parts")) == without_time(log(tmp_path / "whole"))


def test_a_finished_chain_resumes_to_its_results(tmp_path):
    whole, _ = run(tmp_path)
    again, chain = run(tmp_path, resume=True)
    assert all(same(again[key], whole[key]) for key in whole) and chain.iteration == 24


def test_what_a_stage_does_to_its_start_is_its_own_affair(tmp_path):
    whole, _ = run(tmp_path / "a")
    alone, _ = run(tmp_path / "b", stages=plan()[:1])
    assert same(whole["first"], alone["first"])


@pytest.mark.parametrize(("options", "message"), [
    ({"scene": "test", "seed": 4}, "seed 4 .* has seed 3"),
    ({"scene": "other", "seed": 3}, "scene 'other' .* has scene 'test'"),
    ({"scene": "test"}, "seed None .* has seed 3"),
])
def test_other_options_are_refused_by_name(tmp_path, options, message):
    with pytest.raises(Interrupted):
        run(tmp_path, interrupt_at("first", 3))
    content = {path: path.read_bytes() for path in Checkpoints(tmp_path / "checkpoints").paths()}
    with pytest.raises(InputError, match=message):
        run(tmp_path, resume=True, options=options)
    assert content == {path: path.read_bytes() for path in Checkpoints(tmp_path / "checkpoints").paths()}


def test_other_stages_are_refused(tmp_path):
    with pytest.raises(Interrupted):
        run(tmp_path, interrupt_at("first", 3))
    with pytest.raises(InputError, match=r"has the stages .*first"):
        run(tmp_path, resume=True, stages=plan(total=13))


def test_nothing_to_resume_and_nothing_overwritten(tmp_path):
    with pytest.raises(InputError, match="no checkpoint to resume"):
        run(tmp_path, resume=True)
    with pytest.raises(Interrupted):
        run(tmp_path, interrupt_at("first", 3))
    with pytest.raises(InputError, match="stopped at iteration 3; go on with it by --resume"):
        run(tmp_path)
    run(tmp_path, resume=True)
    _, chain = run(tmp_path)  # a finished one may be made again
    assert chain.iteration == 24 and len(log(tmp_path)) == 24


def spoil(field, value):
    def hook(stage):
        if stage.name == "second" and stage.done == 4:
            getattr(stage.gaussians, field).data.view(-1)[2] = value

    return hook


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_parameter_that_is_not_finite_stops_at_its_iteration(tmp_path, value):
    where = r"second: stopped after iteration 16 \(4 of the stage, view 7\): opacity holds"
    with pytest.raises(TrainingError, match=where) as error:
        run(tmp_path, spoil("opacity", value))
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    assert str(checkpoints.paths()[-1]) in str(error.value)
    assert checkpoints.load().stage == 1 and not list(non_finite(checkpoints.load().results))
    whole, _ = run(tmp_path / "whole")
    resumed, _ = run(tmp_path, resume=True)
    assert same(resumed["second"], whole["second"])


def test_a_loss_that_is_not_finite_names_the_field_behind_it(tmp_path):
    def hook(stage):
        if stage.done == 6:
            return {"loss": float("nan")}

    with pytest.raises(TrainingError, match=r"first: stopped after iteration 6 \(6 of the stage, view 7\): the loss is nan; "):
        run(tmp_path / "loss", hook)

    class Hidden(Noise):
        """Shows its parameters in its state alone."""

        def __init__(self, *arguments):
            super().__init__(*arguments)
            self.hidden = self.gaussians

        def step(self):
            self.gaussians = self.hidden
            try:
                return super().step()
            finally:
                del self.gaussians

        def state(self):
            return {"nested": [{"sh_dc": self.hidden.sh_dc.detach().clone()}], "done": self.done}

    def spoil_loss(stage):
        if stage.done == 5:
            stage.gaussians.sh_dc.data[0, 1] = float("nan")
            return {"loss": float("inf")}

    with pytest.raises(TrainingError, match=r"iteration 5 .*: the loss is inf and nested\.0\.sh_dc holds"):
        run(tmp_path / "field", stages=[Planned("hidden", 9, lambda results: Hidden("hidden", gaussians(), 9, spoil_loss))])
    assert Checkpoints(tmp_path / "field" / "checkpoints").load().iteration == 0


def test_large_finite_parameters_are_finite():
    assert list(non_finite({"means": torch.full((1000, 3), 3e38), "best": torch.tensor([float("inf")])})) == []
    assert list(non_finite({"a": {"means": torch.tensor([1.0, float("nan")])}})) == ["a.means"]


class FullDisk:
    """A file on a disk with room for `room` bytes."""

    def __init__(self, file, room):
        self.file, self.room = file, room

    def write(self, data):
        if len(data) > self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self.file.write(data)


def test_a_full_disk_keeps_the_last_checkpoint(tmp_path, monkeypatch):
    real = checkpoint_module.atomic_output
    full = []

    def fill(stage):
        if stage.name == "second" and stage.done == 3:
            full.append(True)

    @contextmanager
    def output(path):
        with real(path) as file:
            yield FullDisk(file, 10) if full else file

    monkeypatch.setattr(checkpoint_module, "atomic_output", output)
    message = r"disk is full \(No space left on device\); the last checkpoint is intact"
    with pytest.raises(TrainingError, match=message) as error:
        run(tmp_path, fill, seconds=0.0)
    full.clear()
    last = Checkpoints(tmp_path / "checkpoints")
    assert str(last.paths()[-1]) in str(error.value)
    assert last.load().iteration == 14
    assert not list((tmp_path / "checkpoints").glob(".*"))
    resumed, _ = run(tmp_path, resume=True)
    whole, _ = run(tmp_path / "whole")
    assert same(resumed["second"], whole["second"])


def test_a_full_disk_shows_through_wrapped_errors():
    with pytest.raises(TrainingError, match="x: cannot be written, the disk is full"), room_needed("x", "kept"):
        try:
            raise OSError(errno.ENOSPC, "No space")
        except OSError as error:
            raise InputError("cannot be written") from error
    with pytest.raises(OSError, match="No such"), room_needed("x", "kept"):
        raise OSError(errno.ENOENT, "No such")


def test_a_damaged_checkpoint_falls_back_to_the_one_before(tmp_path):
    whole, chain = run(tmp_path / "whole")
    with pytest.raises(Interrupted):
        run(tmp_path / "parts", interrupt_at("second", 3))
    newest = Checkpoints(tmp_path / "parts" / "checkpoints").paths()[-1]
    newest.write_bytes(newest.read_bytes()[:100])
    with pytest.warns(UserWarning, match="is no readable checkpoint"):
        resumed, _ = run(tmp_path / "parts", resume=True)
    assert same(resumed["second"], whole["second"])
    for path in chain.checkpoints.paths():
        path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="is no readable checkpoint"):
        run(tmp_path / "whole", resume=True)


class Foreign:
    """Code that a checkpoint from elsewhere might run."""


def test_a_checkpoint_runs_no_code_of_others(tmp_path):
    checkpoint = Checkpoint({}, (), {"x": Foreign()}, 0, None, 0, {}, 1)
    Checkpoints(tmp_path).save(checkpoint)
    with pytest.raises(InputError, match="Foreign"):
        Checkpoints(tmp_path).load()
    assert isinstance(Checkpoints(tmp_path, (Foreign,)).load().results["x"], Foreign)


def test_progress_without_a_terminal_is_ten_lines():
    stream = io.StringIO()
    with Progress("1/2 first", 95, stream=stream) as progress:
        for done in range(1, 96):
            progress.update(done, {"loss": 0.5, "psnr": 20.0, "points": 1234})
    lines = stream.getvalue().splitlines()
    assert len(lines) == 10 and lines[-1].startswith("1/2 first: 95/95, loss 0.5, psnr 20.00, points 1,234, 0 s left")


def test_progress_on_a_terminal_is_a_bar():
    stream = io.StringIO()
    stream.isatty = lambda: True
    with Progress("2/2 second", 50, done=10, stream=stream) as progress:
        for done in range(11, 51):
            progress.update(done, {"loss": 0.25, "points": 10})
        assert progress.bar.n == 50
    assert "loss=0.25" in stream.getvalue() and "points=10" in stream.getvalue() and "2/2 second" in stream.getvalue()


def test_the_kind_of_a_stage_is_in_its_name():
    names = {"dense": "dense", "prune": "prune", "prune-M": "prune", "prune-speedy": "prune", "scale-decay": "scale-decay",
             "finetune-L": "finetune", "level2": "level", "level4-plain": "level", "separate3": "separate", "smfr": "smfr"}
    assert {name: kind_of(name) for name in names} == names


def test_remaining_time_of_the_whole_chain_by_hand():
    """3 s for an iteration of dense training, of which 90 are left; a level costs USUAL times that until its own are known."""
    remaining = Remaining([("dense", 100), ("level2", 10), ("level3", 10), ("smfr", 0)])
    assert remaining.seconds("dense", 0) is None
    for _ in range(10):
        remaining.took("dense", 3.0)
    usual = USUAL["level"] / USUAL["dense"]
    assert remaining.seconds("dense", 10) == pytest.approx(3 * 90 + 20 * 3 * usual)
    for _ in range(5):
        remaining.took("level2", 7.0)
    assert remaining.seconds("level2", 5) == pytest.approx(5 * 7 + 10 * 7)  # what level2 took tells about level3
    for _ in range(1000):
        remaining.took("level2", 1.0)
    assert remaining.seconds("level2", 5) == pytest.approx(15, rel=0.05)  # the mean moves
    assert remaining.seconds("level3", 10) == remaining.seconds("level3", 12) == 0


def test_a_resumed_chain_knows_what_the_first_run_measured():
    spent = {"dense": {"iterations": 100, "seconds": 200.0}, "prune": {"iterations": 0, "seconds": 0.0}}
    remaining = Remaining([("dense", 100), ("prune", 50)], spent)
    assert remaining.seconds("prune", 0) == pytest.approx(50 * 2 * USUAL["prune"])
    remaining.took("prune", 4.0)
    assert remaining.seconds("prune", 1) == pytest.approx(49 * 4)


@pytest.mark.parametrize("terminal", [False, True])
def test_progress_tells_the_time_left_of_all_stages(tmp_path, monkeypatch, terminal):
    """On a clock that steps by what iterations take, 2 s in the first stage and 5 s in the second: lines of both stages end
    with the rest of the whole chain, and they come to 0."""
    now = [0.0]
    monkeypatch.setattr(chain_module.time, "monotonic", lambda: now[0])
    stream = io.StringIO()
    stream.isatty = lambda: terminal
    monkeypatch.setattr(chain_module, "Progress", lambda *arguments: Progress(*arguments, stream=stream))

    def hook(stage):
        now[0] += {"dense": 2.0, "prune": 5.0}[stage.name]

    stages = [Planned("dense", 40, lambda results: Noise("dense", gaussians(), 40, hook)),
              Planned("prune", 20, lambda results: Noise("prune", results["dense"], 20, hook))]
    run(tmp_path, stages=stages)
    if terminal:
        assert "all stages=" in stream.getvalue() and "0 s left" in stream.getvalue()
        return
    reads = r"\d/2 (\w+): (\d+)/.*, (\S+ \w+) of all stages"
    told = [re.fullmatch(reads, line) for line in stream.getvalue().splitlines()]
    assert len(told) == 20 and all(told)
    guessed = 20 * 2 * USUAL["prune"]
    assert [line[3] for line in told[:10]] == [as_time(2 * (40 - done) + guessed) for done in range(4, 41, 4)]
    assert [line[3] for line in told[10:]] == [as_time(5 * (20 - done)) for done in range(2, 21, 2)]


def test_checkpoints_come_by_time(tmp_path, monkeypatch):
    now = iter(range(0, 10000, 7))
    monkeypatch.setattr(chain_module.time, "monotonic", lambda: float(next(now)))
    saved = []
    real = Checkpoints.save
    monkeypatch.setattr(Checkpoints, "save", lambda self, each: saved.append(each.iteration) or real(self, each))
    run(tmp_path, seconds=60.0, stages=plan(total=40)[:1])
    gaps = np.diff(saved)
    assert saved[0] == 0 and saved[-1] == 40 and 3 <= len(saved) <= 8 and gaps.max() <= 9, saved
