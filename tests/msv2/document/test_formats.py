"""docs/formats.md is what spec/ says now."""

from __future__ import annotations

import itertools
import re
import subprocess
import sys
from dataclasses import fields

import pytest

from msv2.document import formats
from msv2.document.__main__ import check, write
from spec import constants
from spec.chunks import CHUNK_RECORDS
from spec.compact import COMPACT_RECORDS
from spec.config import CONFIGS, PAPER, V3, V3_RECORDS, NumberFormats
from spec.errors import InputError
from spec.memory import MEMORY_RECORDS
from spec.packed import PACKED_RECORDS, PackedError
from spec.paths import ROOT
from spec.records import RECORDS, list_group
from spec.supertiles import SUPERTILE_RECORDS


def test_the_page_is_not_stale():
    assert (ROOT / "docs" / "formats.md").read_text(encoding="utf-8") == formats.page(), "run `python -m msv2.document`"


def test_check_writes_nothing_and_names_a_stale_page(tmp_path, capsys):
    path = tmp_path / "formats.md"
    with pytest.raises(InputError, match=r"formats\.md is stale"):
        check(path, formats.page)
    assert not path.exists()
    write(path, formats.page)
    check(path, formats.page)
    assert [p.name for p in tmp_path.iterdir()] == ["formats.md"]
    path.write_text(path.read_text(encoding="utf-8") + "x", encoding="utf-8")
    with pytest.raises(InputError, match="stale"):
        check(path, formats.page)


def test_command_line():
    done = subprocess.run([sys.executable, "-m", "msv2.document", "--check"], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_everything_is_on_the_page():
    page = formats.page()
    for f in fields(NumberFormats):
        assert f"| `{f.name}` | {getattr(NumberFormats(), f.name)} |" in page
    for make in (*RECORDS, *MEMORY_RECORDS):
        record = make(PAPER)
        assert f"### {record.name}: {record.width} bits" in page
        assert all(f"| `{f.name}` |" in page for f in record.fields)
    for make in (*CHUNK_RECORDS, *COMPACT_RECORDS):
        record = make(V3_RECORDS)
        assert f"### {record.name}: {record.width} bits" in page
        assert all(f"| `{f.name}` |" in page for f in record.fields)
    for make in SUPERTILE_RECORDS:
        record = make(V3)
        assert f"### {record.name}: {record.width} bits" in page
        assert all(f"| `{f.name}` |" in page for f in record.fields)
    for make in PACKED_RECORDS:
        record = make(PAPER)
        assert f"### {record.name}: {record.width} bits" in page
        assert all(f"| `{f.name}` |" in page for f in record.fields)
    assert all(f"| {error.value} | `{error.name}` |" in page for error in PackedError)
    assert all(f"| `{name}` |" in page for name in vars(constants) if name.isupper())
    assert f"| parameter | {' | '.join(CONFIGS)} |" in page


def test_bit_ranges_of_each_record_are_contiguous():
    sections = re.split(r"^### ", formats.page(), flags=re.MULTILINE)
    checked = 0
    for section in sections:
        ranges = [(int(high), int(low)) for high, low in re.findall(r"^\| (\d+):(\d+) \|", section, re.MULTILINE)]
        if ranges:
            checked += 1
            assert (ranges[0][1] == 0) == (", besides: " not in section)
            assert all(low == before + 1 for (before, _), (_, low) in itertools.pairwise(ranges))
            assert section.split("\n")[0].removesuffix(" in all").endswith(f": {ranges[-1][0] + 1} bits")
    makes, larger = (*RECORDS, *MEMORY_RECORDS), (PAPER.with_(order="spatial", chunks=True), PAPER.with_(stereo=True))
    grown = [make for make in makes for config in larger if make(config) != make(PAPER)]
    changed = sum(formats.layout(make, V3) != formats.layout(make, V3_RECORDS) for make in (*makes, *CHUNK_RECORDS))
    assert checked == (len(makes) + len(CHUNK_RECORDS) + len(COMPACT_RECORDS) + len(grown) + len(SUPERTILE_RECORDS)
                       + len(PACKED_RECORDS) + len([list_group]) + changed)
    assert changed >= 3  # SurvivingSplat, FrameSettings, HeaderItem


def test_docstrings_are_found_where_they_stand():
    source = 'A = 1\n"""One."""\nclass C:\n    b: int = 2\n    """Two,\n    lines | bar."""\n    c = 3\n'
    assert formats.attribute_docs(source) == {"A": "One.", "b": "Two, lines \\| bar."}
    assert formats.listed_docs("X.\n\nAttributes:\n    a, b: one\n        more.\n    c: two.") == {
        "a": "one more.", "b": "one more.", "c": "two."}
