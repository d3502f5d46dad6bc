"""Equivalence of two emissions: what is the same is proven, what is not is told."""

import pytest
from amaranth.hdl import Module, Signal
from amaranth.lib import wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

pytest.importorskip("pyosys", reason="pyosys is not installed")

from msv2.studies.equivalence import study
from msv2.studies.equivalence.emit import canonical
from msv2.studies.equivalence.prove import differences
from rtl.emit import to_rtlil
from spec.errors import InputError


class Unit(wiring.Component):
    """A sum of two inputs and of what a memory holds; `kind` chooses how it is written down, or a fault."""

    a: In(8)
    b: In(8)
    o: Out(8)

    def __init__(self, kind: str):
        self._kind = kind
        super().__init__()

    def elaborate(self, platform: object):
        m = Module()
        first = [1] if self._kind == "other first value" else []
        m.submodules.memory = memory = Memory(shape=8, depth=64, init=first)
        write, read = memory.write_port(), memory.read_port()
        m.d.comb += [write.addr.eq(self.a[:6]), write.data.eq(self.b), write.en.eq(1), read.addr.eq(self.b[:6])]
        state = Signal(8)
        terms = {"reordered": self.b + read.data + self.a, "subtracts": self.a + self.b - read.data}
        m.d.sync += state.eq(terms.get(self._kind, self.a + self.b + read.data))
        m.d.comb += self.o.eq(state if self._kind != "inverts" else ~state)
        return m


@pytest.fixture
def proof(tmp_path):
    def prove(kind: str) -> bool:
        for name, value in (("before", "plain"), ("after", kind)):
            (tmp_path / f"{name}.il").write_text(to_rtlil(Unit(value), "unit"))
        return not differences(tmp_path / "before.il", tmp_path / "after.il", tmp_path / "proof")
    return prove


@pytest.mark.parametrize(("kind", "same"), [
    ("plain", True), ("reordered", True), ("subtracts", False), ("inverts", False), ("other first value", False)])
def test_what_is_the_same_is_proven_and_what_is_not_is_told(proof, kind, same):
    assert proof(kind) is same


def test_generated_names_do_not_count_and_others_do():
    assert canonical("wire $12 cell $add $34 $12") == canonical("wire $7 cell $add $8 $7")
    assert canonical("wire \\a cell $add $1") != canonical("wire \\b cell $add $1")
    assert canonical("cell $add $1") != canonical("cell $sub $1")


def test_verdicts(tmp_path):
    files = {}
    for name, kind in (("same", "plain"), ("other", "reordered"), ("fault", "inverts")):
        before, after = tmp_path / f"{name}.before.il", tmp_path / f"{name}.after.il"
        before.write_text(to_rtlil(Unit("plain"), "unit"))
        after.write_text(to_rtlil(Unit(kind), "unit"))
        files[f"{name}.unit"] = before, after
    before, after = ({name: pair[i] for name, pair in files.items()} for i in (0, 1))
    found = study.verdicts({**before, "gone.unit": before["same.unit"]}, after, tmp_path / "proofs")
    assert found == {"same.unit": study.SAME, "other.unit": study.PROVEN, "fault.unit": f"{study.DIFFERENT}: unit",
                     "gone.unit": study.MISSING}


@pytest.mark.parametrize(("argv", "named"), [
    (["--against", "HEAD", "--configs", "huge"], "'huge'"), (["--against", "no-such-commit"], "'no-such-commit'")])
def test_bad_values_are_named(tmp_path, argv, named):
    with pytest.raises(InputError, match=named):
        study.main([*argv, "--out", str(tmp_path)])
