"""Cells found by what they do: a small library, what it must have, and where liberty files come from."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

pytest.importorskip("pyosys.libyosys", reason="needs the extra `synth`")

from spec.errors import InputError
from synth.discover import discover, read_cells, truth
from synth.liberty import ASAP7, LIBRARIES, PDK_VARIABLE, find_files


def gate(name: str, area: float, functions: dict[str, str], inputs: str = "AB", more: str = "", pins: str = "") -> str:
    outputs = "".join(f'  pin ({pin}) {{ direction : output;\n function : "{text}"; }}\n' for pin, text in functions.items())
    given = "".join(f"  pin({pin}) {{\n direction : input;\n capacitance : 2.5;\n }}\n" for pin in inputs)
    return f'cell ("{name}") {{\n area : {area};\n {more}\n{given}{outputs}{pins}}}\n'


CELLS = {
    "inverter": gate("NOT1", 2.0, {"Z": "(!A)"}, "A"), "large inverter": gate("NOT4", 4.0, {"Z": "A'"}, "A"),
    "buffer": gate("PASS1", 3.0, {"Q": "A"}, "A"), "NAND": gate("NA2", 3.0, {"Z": "!(A B)"}),
    "adder": gate("ADD", 9.0, {"H": "(A B)+(B C)+(C A)", "L": "A^B^C"}, "ABC"),
    "forbidden": gate("NOT0", 0.5, {"Z": "!A"}, "A", "dont_use : true;"),
    "flop": gate("FLIP", 8.0, {"Q": "IQ"}, "DC", 'ff (IQ,IQN) {\n clocked_on : "C";\n next_state : "D";\n }'),
    "flop with reset": gate("FLIPR", 6.0, {"Q": "IQ"}, "DCR", 'ff (IQ,IQN) {\n clocked_on : "C";\n clear : "R";\n }'),
    "latch": gate("HOLD", 1.0, {"Q": "IQ"}, "DG", "latch (IQ,IQN) {\n }"),
    "one": gate("ONE", 1.0, {"Z": "1"}, ""), "zero": gate("ZERO", 1.0, {"Z": "0"}, ""),
    "clock gate": gate("GATE", 7.0, {}, "", 'clock_gating_integrated_cell : "latch_posedge";',
                       "pin(E) { direction : input;\n clock_gate_enable_pin : true; }\n"
                       "pin(K) { direction : input;\n clock_gate_clock_pin : true; }\n"
                       "pin(O) { direction : output;\n clock_gate_out_pin : true; }\n"),
}


def library(path: Path, without: tuple[str, ...] = ()) -> Path:
    cells = "".join(text for name, text in CELLS.items() if name not in without)
    path.write_text('library (small) {\n/* a note; of (this) file */\n time_unit : "1ns";\n capacitive_load_unit (0.1, pf);\n'
                    f"operating_conditions(typical) {{\n voltage : 1.0;\n}}\n{cells}}}\n")
    return path


def test_cells_are_found_by_function(tmp_path: Path) -> None:
    found, merged = discover(str(library(tmp_path / "small.lib")), tmp_path)
    assert found.inverter == "NOT1" and found.broadcast_buffer == ("PASS1", "A", "Q")
    assert found.full_adder == ("ADD", ("A", "B", "C", "H", "L")) and not found.adder_inverts
    assert found.flop == "FLIP" and found.driver == ("FLIP", "Q")
    assert found.tie_high == ("ONE", "Z") and found.tie_low == ("ZERO", "Z")
    assert found.clock_gate == ("GATE", "E", "K", "O", None)
    assert found.time_unit_ps == 1000.0 and found.load == 10.0 and found.gate_load_ff == 500.0
    assert {cell.name for cell in read_cells(merged)[1]} == {text.split('"')[1] for text in CELLS.values()}


def test_what_a_library_may_lack(tmp_path: Path) -> None:
    path = library(tmp_path / "small.lib", ("adder", "one", "zero", "clock gate"))
    found, _ = discover(str(path), tmp_path)
    assert found.full_adder is found.tie_high is found.tie_low is found.clock_gate is None


@pytest.mark.parametrize("without, message", [
    (("inverter", "large inverter"), "must have a cell that is an inverter"),
    (("buffer",), "must have a cell that is a buffer"),
    (("NAND",), "must have a cell that is a two-input NAND"), (("flop",), "must have a flip-flop without set and reset"),
    (tuple(CELLS), "must be a liberty file"),
])
def test_what_a_library_must_have(without: tuple[str, ...], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        discover(str(library(tmp_path / "small.lib", without)), tmp_path)


@pytest.mark.parametrize("function, table", [
    ("!(A&B)", (1, 1, 1, 0)), ("(A' B)+(A B')", (0, 1, 1, 0)), ("A * !B", (0, 1, 0, 0)), ("(A|B)'", (1, 0, 0, 0)), ("IQ", None),
    ("A &", None)])
def test_functions(function: str, table: tuple[int, ...] | None) -> None:
    """For B A = 00, 01, 10, 11."""
    assert truth(function, ["A", "B"]) == table


def test_files_come_from_the_package_where_it_can_load_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for lambdapdk: asked for its timing models alone; what it cannot download is said."""
    known, module = LIBRARIES["nangate45"], ModuleType("stand_in")
    offered = tmp_path / "NangateOpenCellLibrary_typical.lib"
    offered.write_text("")

    class Nangate45:
        broken = False

        def getkeys(self, key: str) -> tuple[str, ...]:
            return ("models.physical", "models.timing.nldm")

        def get_file(self, fileset: str) -> list[str]:
            if self.broken or fileset != "models.timing.nldm":
                raise FileNotFoundError("no way to the server")
            return [str(offered)]

    module.Nangate45 = Nangate45
    monkeypatch.setitem(sys.modules, known.package[0], module)
    monkeypatch.delenv(PDK_VARIABLE, raising=False)
    assert find_files(known) == [offered]
    Nangate45.broken = True
    with pytest.raises(InputError, match="lambdapdk cannot download them: no way to the server"):
        find_files(known)
    monkeypatch.setitem(sys.modules, ASAP7.package[0], None)
    with pytest.raises(InputError, match="lambdapdk, which downloads them, is not installed"):
        find_files(ASAP7)


def test_a_system_package_may_have_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = replace(LIBRARIES["osu018"], elsewhere=(str(tmp_path),))
    with pytest.raises(InputError, match="osu018"):
        monkeypatch.setenv(PDK_VARIABLE, str(tmp_path / "pdk"))
        find_files(known)
    (tmp_path / "osu018").mkdir()
    (tmp_path / "osu018" / "osu018_stdcells.lib").write_text("")
    assert find_files(known) == [tmp_path / "osu018" / "osu018_stdcells.lib"]
