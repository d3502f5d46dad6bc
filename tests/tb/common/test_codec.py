"""Records to bits and files and back, patterns of pauses: what the testbenches rest on."""

import numpy as np
import pytest

from spec.config import TINY
from spec.formats import SQ, UQ
from spec.packing import pack, unpack
from spec.records import RECORDS, Field, Record
from tb.common.codec import read_hex, write_hex
from tb.common.patterns import PERIOD, Pattern


def random_rows(record: Record, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rows = np.empty(count, record.dtype)
    for f in record.fields:
        low, high = f.raw_range
        rows[f.name] = rng.choice([low, high, rng.integers(low, high + 1)], (count, f.count) if f.count > 1 else count)
    return rows


@pytest.mark.parametrize("make", RECORDS, ids=lambda make: make.__name__)
def test_whole_arrays_pack_as_single_rows_do(make, tmp_path):
    record = make(TINY)
    rows = random_rows(record, 20)
    patterns = pack(record, rows)
    assert [int.from_bytes(p.tobytes(), "little") for p in patterns] == [record.pack(row) for row in rows]
    assert (unpack(record, patterns) == rows).all()
    write_hex(tmp_path / "rows.hex", patterns)
    lines = (tmp_path / "rows.hex").read_text().split()
    assert [int(line, 16) for line in lines] == [record.pack(row) for row in rows]


@pytest.mark.parametrize("width", [1, 4, 5, 8, 13, 64, 193])
def test_lines_as_verilog_writes_them(width, tmp_path):
    rng = np.random.default_rng(width)
    values = [int.from_bytes(rng.bytes(32), "little") % (1 << width) for _ in range(7)]
    (tmp_path / "out").write_text("".join(f"{v:0{(width + 3) // 4}x}\n" for v in values))
    patterns = read_hex(tmp_path / "out", width)
    assert [int.from_bytes(p.tobytes(), "little") for p in patterns] == values


@pytest.mark.parametrize("text", ["12\n3\n", "1x\n", "123\n", "12"])
def test_broken_lines_are_refused(text, tmp_path):
    (tmp_path / "out").write_text(text)
    with pytest.raises(ValueError, match="out"):
        read_hex(tmp_path / "out", 8)


def test_an_empty_file_has_no_rows(tmp_path):
    (tmp_path / "out").write_text("")
    assert read_hex(tmp_path / "out", 13).shape == (0, 2)


@pytest.mark.parametrize("value", [-9, 8])
def test_values_that_do_not_fit_are_refused(value):
    record = Record("R", "", (Field("a", SQ(3, 0), ""), Field("b", UQ(2, 0), "")))
    with pytest.raises(ValueError, match=rf"R\.a must be in -8\.\.7, not {value}"):
        pack(record, np.array([(value, 0)], [("a", np.int64), ("b", np.int64)]))


@pytest.mark.parametrize("pattern", Pattern)
def test_patterns_are_as_they_say(pattern):
    pauses = pattern.pauses(3)
    assert pauses.shape == (PERIOD,) and pauses.dtype == bool and not pauses.all()
    assert (pauses == pattern.pauses(3)).all()
    runs = np.diff(np.flatnonzero(np.diff(pauses.astype(int))))
    if pattern is Pattern.NEVER:
        assert not pauses.any()
    elif pattern is Pattern.ALWAYS:
        assert pauses.mean() == pytest.approx(0.5, abs=1e-3) and runs.max() == 1
    elif pattern is Pattern.TIDAL:
        assert 0.6 < pauses.mean() < 0.7 and runs.max() == PERIOD // 3
    else:
        assert (pauses != pattern.pauses(4)).any()
        assert runs.max() >= (90 if pattern is Pattern.BURSTY else 5)
