"""Memories under a table of macros whose small sizes cost more a bit: by hand, and on the files where they are."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from spec.errors import InputError
from synth.liberty import PDK_VARIABLE
from synth.macro_sizes import ANCHORED, SCALED, SECOND_PORT, SizedMacro, make_sized, table, um2_16nm
from synth.macros import DENSITY_UM2, FLOP_UM2, MUX_UM2, WORD_UM2, make
from synth.memories import Macro
from synth.scaling import TO_16NM

SMALL, LARGE = SizedMacro(64, 32, 2048.0, 200.0), SizedMacro(1024, 32, 16384.0, 300.0)
"""1 and 0.5 um^2 a bit."""

TO_16 = TO_16NM["asap7"].area

needs_pdk = pytest.mark.skipif(not os.environ.get(PDK_VARIABLE), reason=f"{PDK_VARIABLE} names no folder of liberty files")


def test_areas_of_a_macro() -> None:
    macros = SMALL, LARGE
    assert um2_16nm(LARGE, ANCHORED, macros) == pytest.approx(32768 * DENSITY_UM2 * TO_16)  # the densest has the old price
    assert um2_16nm(SMALL, ANCHORED, macros) == pytest.approx(2048 * 2 * DENSITY_UM2 * TO_16)
    assert um2_16nm(SMALL, SCALED, macros) == pytest.approx(2048.0 * SECOND_PORT * TO_16NM["nangate45"].area)


def test_the_smallest_way_is_found() -> None:
    macros = SMALL, LARGE
    large = make_sized(Macro(1024, 64, 1, 1), ANCHORED, macros)
    assert (large.kind, large.macros) == ("1024x32", 2) and large.um2 == pytest.approx(2 * um2_16nm(LARGE, ANCHORED, macros))
    assert large.access_ps == pytest.approx(300.0 / 1.86 * 0.48)
    copied = make_sized(Macro(1024, 64, 2, 1), ANCHORED, macros)
    assert copied.macros == 4
    # 128 words of 16 bits: two small macros with half of their width unused, or one with two words in each row
    folded = make_sized(Macro(128, 16, 1, 1), ANCHORED, (SMALL,))
    assert (folded.kind, folded.macros) == ("64x32", 1)
    assert folded.um2 == pytest.approx(um2_16nm(SMALL, ANCHORED, (SMALL,)) + 16 * MUX_UM2 * TO_16)
    tiny = make_sized(Macro(8, 32, 1, 1), ANCHORED, macros)
    assert (tiny.kind, tiny.macros, tiny.access_ps) == ("flip-flops", 0, 0.0)
    assert tiny.um2 == pytest.approx((8 * 32 * FLOP_UM2 + 7 * 32 * MUX_UM2 + 8 * WORD_UM2) * TO_16)


def test_a_missing_table_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="liberty files in fakeram45/"):
        table(str(tmp_path))


@needs_pdk
def test_the_files() -> None:
    macros, folder = table(), Path(os.environ[PDK_VARIABLE])
    assert len(macros) == 26
    by_bit = [macro.um2_a_bit for macro in macros]
    assert max(by_bit) / min(by_bit) > 4 and min(by_bit) == pytest.approx(0.5007, abs=1e-4)
    for words, width in ((64, 32), (256, 64), (1024, 64), (8192, 64)):
        one, two = (float(re.search(r"\barea\s*:\s*([\d.]+)", (
            folder / "fakeram7" / f"fakeram7_{kind}_{words}x{width}.lib").read_text())[1]) for kind in ("sp", "dp"))
        assert two / one == pytest.approx(SECOND_PORT, abs=0.02)
    for shape in (Macro(127, 257, 1, 1), Macro(2048, 39, 1, 1), Macro(512, 64, 1, 1)):
        assert make_sized(shape, ANCHORED, macros).um2 > 0.97 * make(shape).area_um2 * TO_16
