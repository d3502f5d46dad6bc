"""docs/take_one_unit.md does what it says: its commands run, its testbench is the example's, its output is right."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from golden.msv2_ref.tile_merge import tile_groups
from spec.config import TINY
from spec.paths import ROOT

PAGE = (ROOT / "docs" / "take_one_unit.md").read_text(encoding="utf-8")
TESTBENCH = ROOT / "examples" / "tile_merge_unit" / "ten_lines.v"
BLOCKS = re.findall(r"```(\w*)\n(.*?)```", PAGE, re.DOTALL)


def blocks(kind: str) -> list[str]:
    return [text for name, text in BLOCKS if name == kind]


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder in which all commands of the page were run one after the other, and what the last ones printed."""
    if shutil.which("iverilog") is None:
        pytest.skip("needs Icarus Verilog: apt-get install iverilog")
    folder = tmp_path_factory.mktemp("home")
    shutil.copy(TESTBENCH, folder)
    msv2 = f'msv2() {{ PYTHONPATH="{ROOT}" "{sys.executable}" -m msv2 "$@"; }}'
    said = ""
    for commands in blocks("sh"):
        done = subprocess.run(["bash", "-e", "-c", f"{msv2}\n{commands}"], cwd=folder, capture_output=True, text=True,
                              check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        said = done.stdout
    return folder, said


def test_the_testbench_is_the_file() -> None:
    code, = blocks("verilog")
    assert code == TESTBENCH.read_text() and len(code.splitlines()) == 10


def test_the_output_is_what_the_page_says(played: tuple[Path, str]) -> None:
    expected, = blocks("")
    assert [line for line in played[1].splitlines() if "finish" not in line] == expected.splitlines()


def test_the_output_is_the_golden_renderers(played: tuple[Path, str]) -> None:
    rows = np.array([[int(word) for word in re.findall(r"\d+", line)] for line in blocks("")[0].splitlines()])
    counts = np.bincount(np.arange(20) ** 2 % 6, minlength=6)
    golden = tile_groups(TINY, counts, 3, 12)
    assert rows.tolist() == [[tile, counts[tile], golden["group"][tile]] for tile in range(6)]


def test_the_files_are_there(played: tuple[Path, str]) -> None:
    named = re.findall(r"(?m)^\| `([\w/.]+)`(?: and (three) more)? \|", PAGE.partition("## 2.")[0])
    folder = played[0] / "unit"
    assert len(named) == 6 and all((folder / name).is_file() for name, _ in named)
    assert len(list(folder.glob("*.v"))) == 4 and len(list((folder / "memories").glob("*.v"))) == 1


def test_the_maps_are_those_beside_the_verilog(played: tuple[Path, str]) -> None:
    written = (played[0] / "unit" / "tiny_tile_merge_unit_streams.md").read_text().splitlines()
    shown = PAGE.partition("<!-- map -->\n")[2].partition("<!-- end -->")[0].splitlines()
    rows = [line for line in shown if re.match(r"\| \d", line)]
    assert len(rows) == 6 and all(row in written for row in rows)


def test_links_lead_to_files() -> None:
    for target in re.findall(r"\]\(([^)#]+)(?:#\w+)?\)", PAGE):
        assert (ROOT / "docs" / target).resolve().is_file(), target
