"""The delay of an inverter with a fan-out of four: in a library of round delays, and in the libraries of the reports."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from synth import linked, timing
from synth.corners import CORNERS
from synth.discover import discover
from synth.fo4 import chain, fo4_ps, pins_of_inverter
from synth.liberty import PDK_VARIABLE
from synth.scaling import FO4_PS
from tests.helpers.small_machine import LIBERTY

needs_sta = pytest.mark.skipif(not timing.available(), reason=linked.INSTALL)
needs_pdk = pytest.mark.skipif(not os.environ.get(PDK_VARIABLE), reason=f"{PDK_VARIABLE} names no folder of liberty files")


@needs_sta
def test_the_delay_of_a_stage_is_that_of_the_library(tmp_path: Path) -> None:
    library = tmp_path / "small.lib"
    library.write_text(LIBERTY)
    assert fo4_ps("INV", library, 1.0, tmp_path) == pytest.approx(10.0)
    buffers, inverters = LIBERTY.split("cell (INV)", 1)
    slower = inverters.replace('cell_rise (scalar) { values ("10")', 'cell_rise (scalar) { values ("16")', 1)
    library.write_text(f"{buffers}cell (INV){slower}")
    assert fo4_ps("INV", library, 1.0, tmp_path) == pytest.approx(13.0)  # the mean of both edges


def test_every_inverter_drives_four() -> None:
    text = chain("INV", "A", "Y")
    assert text.count(".A(n5)") == 4 and text.count(".A(z)") == 0


def test_a_cell_that_is_no_inverter_is_refused() -> None:
    assert pins_of_inverter(LIBERTY, "INV") == ("A", "Y")
    for cell in ("DFF", "NAND"):
        with pytest.raises(ValueError, match=f"{cell} must be an inverter"):
            pins_of_inverter(LIBERTY, cell)


@needs_sta
@needs_pdk
@pytest.mark.parametrize("name", sorted(FO4_PS))
def test_the_libraries_delays_are_the_stated_ones(name: str, tmp_path: Path) -> None:
    corners = {"asap7": CORNERS["typical"], "asap7_ss": CORNERS["slow"]}
    if name in corners:
        technology, liberty = corners[name].technology, corners[name].liberty(tmp_path)
    else:
        technology, liberty = discover(name, tmp_path)
    assert fo4_ps(technology.inverter, liberty, technology.time_unit_ps, tmp_path) == pytest.approx(FO4_PS[name], abs=0.1)
