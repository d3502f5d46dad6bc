"""Objects of Verilator's library: compiled once for a command line, and no command's object given to another."""

import subprocess
import sys

import pytest

from tb.common import library_objects

COMPILER = """#!/bin/sh
# Writes its command line as the object, and a line in a log.
for last; do :; done
echo "$last" >> {log}
case "$*" in *wrong*) exit 3;; esac
while [ "$1" != -o ]; do flags="$flags $1"; shift; done
echo "$flags of $last" > "$2"
"""


@pytest.fixture
def compiler(tmp_path, monkeypatch):
    """Calls the script as make does; `compiled` are the sources that the compiler really saw."""
    log, program, library = tmp_path / "log", tmp_path / "g++", tmp_path / "include"
    program.write_text(COMPILER.format(log=log))
    program.chmod(0o755)
    library.mkdir()

    def compile_in(model, *flags, source="include/verilated.cpp"):
        folder = tmp_path / model
        folder.mkdir(exist_ok=True)
        done = subprocess.run(
            [sys.executable, "-IS", library_objects.__file__, tmp_path / "kept", library,
             program, *flags, "-MMD", "-c", "-o", "x.o", tmp_path / source], cwd=folder, check=False)
        return done.returncode, (folder / "x.o").read_text() if (folder / "x.o").exists() else None

    compile_in.compiled = lambda: len(log.read_text().splitlines())
    return compile_in


def test_a_second_model_gets_the_first_ones_object(compiler):
    first, second = compiler("a", "-O1"), compiler("b", "-O1")
    assert first == second and first[0] == 0 and "-O1" in first[1] and compiler.compiled() == 1


def test_other_options_or_sources_give_other_objects(compiler):
    found = {compiler("a", "-O1")[1], compiler("a", "-O2")[1], compiler("a", "-O2", source="include/verilated_vpi.cpp")[1]}
    assert len(found) == 3 and compiler.compiled() == 3


def test_what_a_model_changes_in_its_copy_stays_its_own(compiler, tmp_path):
    _, text = compiler("a")
    (tmp_path / "a" / "x.o").write_text("changed")
    assert compiler("b") == (0, text)


def test_what_is_not_the_librarys_is_compiled_every_time(compiler, tmp_path):
    for _ in range(2):
        assert compiler("a", source="model/top.cpp")[0] == 0
        assert compiler("a", f"-I{tmp_path / 'a'}")[0] == 0  # headers of the model's own
    assert compiler.compiled() == 4


def test_a_failure_is_told_and_not_kept(compiler):
    assert compiler("a", "-Dwrong") == (3, None) == compiler("b", "-Dwrong") and compiler.compiled() == 2
