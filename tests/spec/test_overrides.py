"""Configurations without editing source: what is accepted, what is refused and how, names, files and records."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import pytest

from spec.config import CONFIGS, MACHINES, PAPER, TINY, TINY_V3, V3, V3_RECORDS, AcceleratorConfig, NumberFormats
from spec.errors import InputError
from spec.formats import SQ, UQ, Fixed, SmallFloat, parse_format
from spec.overrides import (
    NAMES,
    add_config_arguments,
    changed,
    config_from,
    config_from_record,
    config_record,
    convert,
    read_file,
    recorded_config,
    resolve_config,
)
from spec.paths import ROOT


@pytest.mark.parametrize("number", [
    *{value for value in vars(NumberFormats()).values() if not isinstance(value, int)},
    UQ(0, 1), UQ(53, 0), SQ(0, 53), SQ(12, 0), SmallFloat(2, 2, -1000), SmallFloat(25, 10, 1000, signed=False)], ids=str)
def test_a_format_is_read_as_it_is_written(number):
    assert parse_format(str(number)) == number
    assert parse_format(f"  {number} ") == number


def test_the_notation_in_words():
    assert (str(UQ(1, 8)), str(SQ(5, 14))) == ("UQ1.8", "SQ5.14")
    assert str(SmallFloat(18, 8, 127)) == "float18e8b127" and str(SmallFloat(12, 6, 40, signed=False)) == "ufloat12e6b40"
    numbers = UQ(1, 8), SQ(5, 14), SmallFloat(18, 8, 127), SmallFloat(12, 6, 40, signed=False)
    assert [number.width for number in numbers] == [9, 20, 26, 17]
    assert (SQ(5, 14).raw_min, SQ(5, 14).raw_max) == (-(32 << 14), (32 << 14) - 1)


@pytest.mark.parametrize("text", [
    "", "UQ1", "UQ1.8.1", "Q1.8", "uq1.8", "UQ-1.8", "SQ5,14", "float18", "float18e8", "sfloat18e8b127", "float18e8b",
    "UQ1.8 x"])
def test_what_is_no_format_is_refused(text):
    with pytest.raises(InputError, match=r"is not accepted: write it as in UQ1\.8, SQ5\.14, float18e8b127 or ufloat") as caught:
        parse_format(text)
    assert repr(text) in str(caught.value)


@pytest.mark.parametrize(("text", "why"), [
    ("UQ0.0", r"int_bits \+ frac_bits must be in 1..53, not 0"), ("SQ30.30", r"must be in 1..53, not 60"),
    ("float26e8b127", "sig_bits must be in 2..25, not 26"), ("float18e11b127", "exp_bits must be in 2..10, not 11")])
def test_formats_out_of_limits_are_refused(text, why):
    with pytest.raises(InputError, match=why):
        parse_format(text)


def test_a_parameter_and_a_format_are_set():
    config = resolve_config("paper", ["splat_cache_lines=4096", "formats.colour=UQ1.8"])
    assert config.with_(name="paper") == PAPER.with_(splat_cache_lines=4096, formats=replace(PAPER.formats, colour=UQ(1, 8)))


@pytest.mark.parametrize(("text", "name", "value"), [
    ("cores_x=8", "cores_x", 8), ("depth=false", "depth", False), ("stereo=1", "stereo", True), ("blend=0", "blend", False),
    ("counters=TRUE", "counters", True), ("support_sigma=none", "support_sigma", None),
    ("support_sigma=2.5", "support_sigma", 2.5),
    ("warp_fill=interior", "warp_fill", "interior"), (" merge_ways = 4 ", "merge_ways", 4)])
def test_values_take_the_type_of_their_field(text, name, value):
    got = getattr(resolve_config("paper", [text]), name)
    assert got == value and type(got) is type(value)


@pytest.mark.parametrize("config", MACHINES.values(), ids=lambda config: config.name)
def test_command_lines_take_every_machine_by_its_name(config):
    assert resolve_config(config.name) == config == recorded_config({"config": config.name})
    assert CONFIGS.keys() < MACHINES.keys()


@pytest.mark.parametrize("config", CONFIGS.values(), ids=lambda config: config.name)
def test_a_record_holds_everything_and_makes_the_machine_again(config):
    """Whatever the base, all values of a record set by `--set` give the machine that was recorded."""
    other = config.with_(stereo=not config.supertiles, support_sigma=None, warp_fill="interior")
    record = json.loads(json.dumps(config_record(other)))
    assert record.pop("name") == config.name
    assert set(record) == {f.name for f in fields(AcceleratorConfig)} - {"name"}
    assert set(record["formats"]) == {f.name for f in fields(NumberFormats)}
    formats = record.pop("formats")
    sets = [f"{name}={'none' if value is None else value}" for name, value in record.items()]
    again = resolve_config("tiny", [*sets, *(f"formats.{name}={value}" for name, value in formats.items())])
    assert again.with_(name=other.name) == other


def test_a_record_from_before_chunks_is_a_machine_without_them():
    record = config_record(PAPER)
    for name in ("order", "chunks", "records"):
        del record[name]
    del record["formats"]["chunk"]
    assert config_from_record(record) == PAPER
    with pytest.raises(InputError, match=r"record without chunks, formats\.chunk is not accepted"):
        config_from_record(record | {"order": "spatial", "records": "wide"})


def test_a_record_from_before_super_tiles_is_a_machine_without_them():
    record, names = config_record(V3_RECORDS), ("lists", "list_heads", "buckets", "header_lines", "batch_places")
    for name in names:
        del record[name]
    assert config_from_record(record) == V3_RECORDS
    with pytest.raises(InputError, match=r"record without list_heads, buckets, header_lines, batch_places is not accepted"):
        config_from_record(record | {"lists": "tile"})
    for machine in (V3, TINY_V3):
        assert config_from_record(config_record(machine)) == machine


@pytest.mark.parametrize(
    ("name", "value"),
    [("lockstep", False), ("streams", 1), ("packed", False), ("joint", False), ("overlap", False), ("bank_memories", False),
     ("read_beats", 512)])
def test_a_record_from_before_a_parameter_is_a_machine_without_it(name, value):
    record = config_record(V3)
    assert record.pop(name) == value
    assert config_from_record(record) == V3


def test_every_field_can_be_set():
    assert set(NAMES) == {f.name for f in fields(AcceleratorConfig)} - {"formats"} | {
        f"formats.{f.name}" for f in fields(NumberFormats)}
    for name in NAMES:
        value = getattr(PAPER.formats, name.partition(".")[2]) if "." in name else getattr(PAPER, name)
        assert convert(name, str(value)) == value


@pytest.mark.parametrize(("texts", "message"), [
    (["splat_cache_line=4"],
     r"parameter 'splat_cache_line' is not accepted: choose one of name, cores_x, .*; did you mean 'splat_cache_lines'\?"),
    (["cache=4"], r"did you mean 'splat_cache_lines'\?"),
    (["colour=UQ1.8"], r"did you mean 'formats.colour'\?"),
    (["formats.color=UQ1.8"], r"choose one of formats.position, .*did you mean 'formats.colour'\?"),
    (["zzz=1"], r"parameter 'zzz' is not accepted: choose one of name, (?!.*did you mean)"),
    (["formats=UQ1.8"], r"name one format, as in formats.colour=UQ1.8"),
    (["splat_cache_lines"], r"set 'splat_cache_lines' is not accepted: write NAME=VALUE"),
    (["=3"], r"set '=3' is not accepted"),
    (["splat_cache_lines=many"], r"splat_cache_lines 'many' is not accepted: a whole number is"),
    (["splat_cache_lines=2.5"], r"splat_cache_lines '2.5' is not accepted: a whole number is"),
    (["splat_cache_lines=3"],
     r"'paper' with splat_cache_lines=3 is not accepted: splat_cache_lines must be in 4..65536, not 3"),
    (["splat_cache_lines=48"], r"must be a power of two, not 48"),
    (["cores_x=5"], r"cores_x must divide 16, not 5"),
    (["depth=maybe"], r"depth 'maybe' is not accepted: true or false is"),
    (["support_sigma=far"], r"support_sigma 'far' is not accepted: a number or none is"),
    (["support_sigma=nan"], r"support_sigma must be None or in 0.5..8, not nan"),
    (["order=depth"], r"order must be one of file, spatial, not 'depth'"),
    (["chunks=true"], r"order must be 'spatial' in a machine with chunks, not 'file'"),
    (["warp_fill=all"], r"warp_fill must be one of majority, interior, not 'all'"),
    (["formats.colour=SQ1.8"], r"formats.colour 'SQ1.8' is not accepted: an unsigned fixed-point format is, written as UQ1.9"),
    (["formats.view=UQ1.8"], r"formats.view 'UQ1.8' is not accepted: a signed small float is, written as float20e8b127"),
    (["formats.scale=float12e6b40"], r"an unsigned small float is, written as ufloat12e6b40"),
    (["formats.colour=9"], r"formats.colour: format '9' is not accepted: write it as in"),
    (["formats.exp2_segments=x"], r"formats.exp2_segments 'x' is not accepted: a whole number is"),
    (["stereo=true", "depth=false"], r"depth must be True in a machine with stereo, not False"),
    (["formats.cut=SQ3.11"], r"formats.cut must have the fraction bits of log2_opacity, 10, not SQ3.11"),
    (["name=a/b"], r"name 'a/b' is not accepted: letters, digits and underscores are"),
])
def test_bad_names_and_values_are_answered_with_what_is_accepted(texts, message):
    with pytest.raises(InputError, match=message):
        resolve_config("paper", texts)


def test_a_wrong_machine_is_answered_with_the_nearest():
    with pytest.raises(InputError, match=r"config 'papre' is not accepted: choose one of tiny, .*; did you mean 'paper'\?"):
        resolve_config("papre")


def test_names_depend_on_what_differs_alone():
    one = resolve_config("paper", ["splat_cache_lines=4096", "depth=false"])
    assert one.name == resolve_config("paper", ["depth=0", "splat_cache_lines=4096"]).name
    assert one.name == resolve_config("paper", ["depth=1", "depth=0", "splat_cache_lines=4096", "cores_x=16"]).name
    assert one.name.startswith("paper_x") and one.name.isidentifier()
    others = [resolve_config("paper", ["splat_cache_lines=4096"]), resolve_config("default", ["splat_cache_lines=4096"]),
              resolve_config("paper", ["splat_cache_lines=1024"]), resolve_config("paper", ["formats.colour=UQ1.8"]),
              resolve_config("paper", ["name=mine", "depth=false"]), resolve_config("paper", ["name=mine"]), one, PAPER]
    assert len({config.name for config in others}) == len(others)
    assert resolve_config("paper", ["name=mine"]).name.startswith("mine_x")


def test_a_name_is_the_same_in_every_process():
    """Python's own hashes differ from process to process; build folders must not."""
    command = "from spec.overrides import resolve_config; print(resolve_config('tiny', ['warp_lanes=2']).name)"
    names = {subprocess.run([sys.executable, "-c", command], cwd=ROOT, env={"PYTHONHASHSEED": seed}, check=True,
                            capture_output=True, text=True).stdout.strip() for seed in ("1", "2")}
    assert names == {resolve_config("tiny", ["warp_lanes=2"]).name}


def test_without_changes_a_machine_stays_what_it_is():
    for name, config in CONFIGS.items():
        assert resolve_config(name) is config and resolve_config(name, [f"cores_x={config.cores_x}"]) is config
    assert changed(TINY, {}) is TINY


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_says_the_same_as_the_command_line(tmp_path):
    path = written(tmp_path, """
        config = "paper"
        splat_cache_lines = 4096
        support_sigma = "none"
        stereo = true
        [formats]
        colour = "UQ1.8"
        exp2_segments = 8
        """)
    sets = ["splat_cache_lines=4096", "support_sigma=none", "stereo=true", "formats.colour=UQ1.8", "formats.exp2_segments=8"]
    assert resolve_config("tiny", file=path) == resolve_config("paper", sets)
    assert read_file(path)[0] == "paper"
    over = resolve_config("tiny", ["splat_cache_lines=1024"], path)
    assert over == resolve_config("paper", [*sets, "splat_cache_lines=1024"])


def test_a_file_without_a_machine_changes_the_default(tmp_path):
    path = written(tmp_path, "warp_lanes = 2\nsupport_sigma = 2\n")
    config = resolve_config("tiny", file=path)
    assert (config.warp_lanes, config.support_sigma, config.cores_x) == (2, 2.0, TINY.cores_x)


@pytest.mark.parametrize(("text", "message"), [
    ("config = 3", r"mine.toml: config 3 is not accepted: one of tiny, "),
    ('config = "huge"', r"config 'huge' is not accepted: choose one of tiny"),
    ("splat_cache_line = 4", r"mine.toml: parameter 'splat_cache_line' .*did you mean 'splat_cache_lines'"),
    ("splat_cache_lines = true", r"mine.toml: splat_cache_lines True is not accepted: a whole number is"),
    ("splat_cache_lines = 2.0", r"mine.toml: splat_cache_lines 2.0 is not accepted: a whole number is"),
    ("depth = 1", r"mine.toml: depth 1 is not accepted: true or false is"),
    ("support_sigma = true", r"mine.toml: support_sigma True is not accepted: a number or none is"),
    ("warp_fill = 1", r"mine.toml: warp_fill 1 is not accepted: one of majority, interior is"),
    ("name = 1", r"mine.toml: name 1 is not accepted: a name is"),
    ("formats = 1", r"mine.toml: formats 1 is not accepted: a table \[formats\] is"),
    ("[formats]\ncolour = 9", r"mine.toml: formats.colour 9 is not accepted: an unsigned fixed-point format is"),
    ("[formats]\ncolor = 'UQ1.8'", r"did you mean 'formats.colour'"),
    ("cores_x = ", r"mine.toml' is not TOML: "),
])
def test_bad_files_are_answered_with_their_path(text, message, tmp_path):
    with pytest.raises(InputError, match=message):
        resolve_config("paper", file=written(tmp_path, text))


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"absent.toml' cannot be read: No such file"):
        resolve_config("paper", file=tmp_path / "absent.toml")
    path = tmp_path / "binary.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="is not TOML"):
        resolve_config("paper", file=path)


def parsed(*argv: str, default: str = "paper") -> AcceleratorConfig:
    parser = argparse.ArgumentParser()
    add_config_arguments(parser, default)
    return config_from(parser.parse_args(argv), default)


def test_the_arguments_of_commands(tmp_path, capsys):
    assert parsed() is PAPER and parsed("--config", "tiny") is TINY
    both = resolve_config("tiny", ["depth=0", "warp_lanes=2"])
    assert parsed("--set", "depth=0", "--config", "tiny", "--set", "warp_lanes=2") == both
    path = written(tmp_path, "warp_lanes = 2\n")
    assert parsed("--config", str(path), "--set", "depth=0", default="tiny") == both
    with pytest.raises(SystemExit):
        parsed("--help")
    shown = " ".join(capsys.readouterr().out.split())
    assert "--set NAME=VALUE" in shown and "balanced" in shown and "default: paper" in shown


def test_values_of_a_kind_that_is_not_the_fields_do_not_pass():
    assert isinstance(convert("formats.colour", "UQ1.8"), Fixed)
    for value in (None, [], 1.5, {}):
        with pytest.raises(InputError):
            convert("cores_x", value)
