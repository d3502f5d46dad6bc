"""The C driver: alone against registers in Python, and on the RTL in Verilator, where its frame is the golden renderer's."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from golden.host.memory_image import MemoryImage
from golden.msv2_ref.joint import render_joint
from golden.msv2_ref.pipeline import Frame, render
from golden.scenes.embedded.splats import cached_embedded_model
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.stereo import stereo_pair
from spec.codes import ErrorCode
from spec.config import TINY, TINY_EYES, TINY_V3, AcceleratorConfig
from spec.errors import InputError
from spec.host_settings import settings, with_every_register
from spec.images import IMAGE_MAGIC, IMAGE_VERSION, RECORD_FORMATS, record_format
from spec.paths import DOCS, ROOT
from spec.registers import MAGIC, SETTINGS_BASE, VERSION_MAJOR, fingerprint, identity, register_map
from tb.top.check import frame_run
from tb.top.player import Map, setting_writes

DRIVER = ROOT / "examples" / "driver"
BUILT = ROOT / "build" / "examples" / "driver"
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wstrict-prototypes", "-Werror")
(OK, NO_MACHINE, OTHER_VERSION, BAD_IMAGE, OTHER_MACHINE, BAD_ADDRESS, BUSY, TIMEOUT, FRAME_FAILED, OTHER_IMAGE,
 OTHER_FORMAT) = range(11)
AT = {register.name: register.offset for register in register_map(TINY)}
DRAM = 0x40000
TARGET = 6 + 9
"""The word of `target` in the structure of an image, behind three pointers and nine words."""

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")

PORT = """\
#include "msv2_driver.h"
uint32_t (*on_read)(uint32_t); void (*on_write)(uint32_t, uint32_t);
void (*on_store)(uint32_t, const uint8_t *, uint32_t); int (*on_wait)(uint32_t);
uint32_t msv2_read(void *port, uint32_t offset) { (void)port; return on_read(offset); }
void msv2_write(void *port, uint32_t offset, uint32_t value) { (void)port; on_write(offset, value); }
void msv2_store(void *port, uint32_t a, const uint8_t *b, uint32_t n) { (void)port; on_store(a, b, n); }
int msv2_wait(void *port, uint32_t timeout) { (void)port; return on_wait(timeout); }
"""


def example(name: str) -> ModuleType:
    """A module of the example's folder, which is no package."""
    found = importlib.util.spec_from_file_location(f"driver_{name}", DRIVER / f"{name}.py")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


class Words(ctypes.Structure):
    """Room for a structure of the driver, as words; the tests read the fields that begin it."""

    _fields_ = [("words", ctypes.c_uint32 * 64)]


class Registers:
    """A port in Python: registers by offset, and lists of what the driver has done."""

    def __init__(self, library: ctypes.CDLL):
        self.values = {AT[name]: value for name, value in identity(TINY).items()}
        self.written: list[tuple[int, int]] = []
        self.stored: dict[int, bytes] = {}
        self.waits = [1]
        kinds = {
            "on_read": (ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_uint32), lambda offset: self.values.get(offset, 0)),
            "on_write": (ctypes.CFUNCTYPE(None, ctypes.c_uint32, ctypes.c_uint32), lambda *pair: self.written.append(pair)),
            "on_store": (ctypes.CFUNCTYPE(None, ctypes.c_uint32, ctypes.c_void_p, ctypes.c_uint32), self.store),
            "on_wait": (ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_uint32), lambda timeout: self.waits.pop(0))}
        self.kept = {name: kind(call) for name, (kind, call) in kinds.items()}
        for name, call in self.kept.items():
            ctypes.c_void_p.in_dll(library, name).value = ctypes.cast(call, ctypes.c_void_p).value

    def store(self, address: int, data: int, count: int) -> None:
        self.stored[address] = ctypes.string_at(data, count)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The driver as a shared library, compiled as strict C99 with all warnings as errors."""
    folder = tmp_path_factory.mktemp("driver")
    (folder / "port.c").write_text(PORT)
    built = folder / "driver.so"
    subprocess.run(["gcc", *WARNINGS, "-shared", "-fPIC", "-I", DRIVER, "-I", DOCS, DRIVER / "msv2_driver.c", DRIVER / "demo.c",
                    folder / "port.c", "-o", built], check=True)
    return ctypes.CDLL(str(built))


@pytest.fixture(scope="module")
def frame() -> Frame:
    model = cached_embedded_model()
    model = model.select(np.linspace(0, len(model) - 1, 200).astype(np.int64))
    return render(model, embedded_cameras(32, 32)[0], config=TINY)


@pytest.fixture(scope="module")
def image(frame: Frame) -> MemoryImage:
    return frame_run(frame, None, display=True).image


@pytest.fixture(scope="module")
def packed(image: MemoryImage) -> bytes:
    return example("frame_image").frame_image_bytes(image)


def opened(library: ctypes.CDLL, data: bytes) -> tuple[int, Words, bytes]:
    """The result for an image, its structure, and the bytes, which must live as long."""
    found = Words()
    return library.msv2_image_open(ctypes.byref(found), data, ctypes.c_uint32(len(data))), found, data


def probed(library: ctypes.CDLL) -> Words:
    machine = Words()
    assert library.msv2_probe(None, ctypes.byref(machine)) == OK
    return machine


@needs_gcc
def test_the_machine_is_recognised(library: ctypes.CDLL) -> None:
    registers, machine = Registers(library), Words()
    assert list(probed(library).words[:7]) == [
        VERSION_MAJOR, identity(TINY)["version"] & 0xFFFF, identity(TINY)["fingerprint"], TINY.cores_x, TINY.cores_y,
        TINY.levels, TINY.row_width]
    registers.values[AT["version"]] = VERSION_MAJOR + 1 << 16
    assert library.msv2_probe(None, ctypes.byref(machine)) == OTHER_VERSION
    registers.values[AT["id"]] = MAGIC ^ 1
    assert library.msv2_probe(None, ctypes.byref(machine)) == NO_MACHINE


@needs_gcc
def test_the_image_is_stored_where_it_belongs(library: ctypes.CDLL, image: MemoryImage, packed: bytes) -> None:
    registers = Registers(library)
    result, found, data = opened(library, packed)
    assert result == OK and data is packed
    assert library.msv2_load(None, ctypes.byref(probed(library)), ctypes.byref(found), DRAM) == OK
    assert registers.stored == {
        DRAM + 32 * image.regions[name].base: rows.tobytes() for name, rows in image.contents.items() if len(rows)}


@needs_gcc
def test_settings_are_those_of_the_host_with_moved_bases(library: ctypes.CDLL, image: MemoryImage, packed: bytes) -> None:
    registers = Registers(library)
    _, found, _ = opened(library, packed)
    library.msv2_set_frame(None, ctypes.byref(found), DRAM)
    moved = {f"{name}_base" for name in image.regions}
    assert registers.written == [
        (AT[name], value + (DRAM // 32 if name in moved else 0)) for name, value in setting_writes(TINY, image, {}).items()]
    assert len(registers.written) == len(list(settings(TINY))) and len(moved & AT.keys()) == len(moved)


@needs_gcc
@pytest.mark.parametrize("machine", with_every_register(TINY), ids=["stereo", "super-tiles", "joint frames", "warped"])
def test_every_base_is_moved(library: ctypes.CDLL, machine: AcceleratorConfig) -> None:
    """Of the machines with all registers: whatever setting is an address in memory, and no other."""
    registers = Registers(library)
    at = {setting.name: SETTINGS_BASE + 4 * setting.number for setting in settings(machine)}
    head = [IMAGE_MAGIC, IMAGE_VERSION, record_format(machine), fingerprint(machine), len(at), 0, 1, 1, 4, 0, 6 * 32]
    data = np.array([*head, *(word for offset in at.values() for word in (offset, 5))], "<u4").tobytes()
    result, found, _ = opened(library, data)
    assert result == OK
    library.msv2_set_frame(None, ctypes.byref(found), DRAM)
    assert registers.written == [(offset, 5 + DRAM // 32 * name.endswith("_base")) for name, offset in at.items()]


@needs_gcc
def test_the_image_of_a_joint_frame_says_where_the_second_eye_is(library: ctypes.CDLL, tmp_path: Path) -> None:
    model = cached_embedded_model().select(np.arange(50))
    camera, eyes = embedded_cameras(32, 32)[0], TINY_EYES.with_(packed=True)
    both = example("frame_image").write_frame_image(render_joint(model, stereo_pair(camera), config=eyes), tmp_path / "both")
    one = example("frame_image").write_frame_image(render(model, camera, config=eyes), tmp_path / "one")
    target = 32 * both.regions["target_frame"].base
    for name, wanted in (("both", target), ("one", 0)):
        result, found, _ = opened(library, (tmp_path / name).read_bytes())
        assert result == OK and found.words[TARGET] == wanted
    assert one.settings["target_frame_base"] and target == 32 * (both.regions["frame"].end + 5)
    data, at = np.fromfile(tmp_path / "both", "<u4"), {register.name: register.offset for register in register_map(eyes)}
    pairs = data[11 : 11 + 2 * data[4]].reshape(-1, 2)
    pairs[pairs[:, 0] == at["target_frame_base"], 1] = both.beats
    assert opened(library, data.tobytes())[0] == BAD_IMAGE


@needs_gcc
def test_images_that_are_none_are_refused(library: ctypes.CDLL, packed: bytes) -> None:
    def changed(word: int, value: int) -> bytes:
        return packed[:4 * word] + struct.pack("<I", value) + packed[4 * word + 4:]

    first = 11 + 2 * struct.unpack_from("<I", packed, 16)[0]
    wrong = {
        "empty": b"", "magic alone": packed[:4], "head cut off": packed[:40],
        "settings cut off": packed[:80], "contents cut off": packed[:-1],
        "magic": changed(0, 1), "few settings": changed(4, 50), "many settings": changed(4, 0xFFFFFFFF),
        "many settings of 8 bytes": changed(4, (len(packed) - 44) // 8 + 1),
        "setting before the settings": changed(11, 0x20), "setting behind them": changed(11, 0x400),
        "setting within a word": changed(11, 0x102), "many segments": changed(5, 0xFFFFFFFF), "little memory": changed(10, 32),
        "segment beyond memory": changed(first, 1 << 31),
        "segment of 4 GB": changed(first + 1, 0xFFFFFFFF), "place beyond the file": changed(first + 2, 0xFFFFFFE0)}
    assert opened(library, packed)[0] == OK
    for name, data in wrong.items():
        assert opened(library, data)[0] == BAD_IMAGE, name
    for version in (0, IMAGE_VERSION - 1, IMAGE_VERSION + 1):
        assert opened(library, changed(1, version))[0] == OTHER_IMAGE


@needs_gcc
def test_loading_is_refused(library: ctypes.CDLL, packed: bytes) -> None:
    """Another machine's image, an address within a beat or too high, and a machine at work: nothing is stored."""
    registers = Registers(library)
    _, found, _ = opened(library, packed)
    machine = probed(library)
    for dram in (1, 16, 0xFFFFFFE0):
        assert library.msv2_load(None, ctypes.byref(machine), ctypes.byref(found), ctypes.c_uint32(dram)) == BAD_ADDRESS
    registers.values[AT["status"]] = Map(TINY).value("status", busy=1)[1]
    assert library.msv2_load(None, ctypes.byref(machine), ctypes.byref(found), DRAM) == BUSY
    assert library.msv2_start(None) == BUSY
    _, compact, _ = opened(library, struct.pack("<III", IMAGE_MAGIC, IMAGE_VERSION, 2) + packed[12:])
    assert library.msv2_load(None, ctypes.byref(machine), ctypes.byref(compact), DRAM) == OTHER_FORMAT
    machine.words[2] ^= 1
    assert library.msv2_load(None, ctypes.byref(machine), ctypes.byref(found), DRAM) == OTHER_MACHINE
    assert not registers.stored and not registers.written


@needs_gcc
@pytest.mark.parametrize("chunks", [0, 1])
@pytest.mark.parametrize("compact", [0, 1])
def test_images_of_another_record_format_are_refused(
    library: ctypes.CDLL, packed: bytes, chunks: int, compact: int,
) -> None:
    """A machine tells by its identity register what it reads; only an image of that format passes."""
    registers = Registers(library)
    for bits in next(register for register in register_map(TINY) if register.name == "machine_array").bits:
        if bits.name in ("chunks", "compact"):
            registers.values[AT["machine_array"]] |= {"chunks": chunks, "compact": compact}[bits.name] << bits.low
    machine, wanted = probed(library), 2 if compact else chunks
    for records in (*range(len(RECORD_FORMATS)), 77):
        _, found, _ = opened(library, packed[:8] + struct.pack("<I", records) + packed[12:])
        result = library.msv2_load(None, ctypes.byref(machine), ctypes.byref(found), DRAM)
        assert result == (OK if records == wanted else OTHER_FORMAT)


def test_an_image_is_read_back_by_its_machine_alone(
    packed: bytes, image: MemoryImage, tmp_path: Path, capsys: pytest.CaptureFixture,
) -> None:
    path, module = tmp_path / "frame.img", example("frame_image")
    path.write_bytes(packed)
    assert module.main(["--config", "tiny", "--read", str(path)]) == 0
    assert f"32x32 pixels, wide records, {len(list(settings(TINY)))} settings" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"frame.img is not accepted: it holds wide records, and config 'v3' reads"):
        module.main(["--config", "v3", "--read", str(path)])
    with pytest.raises(InputError, match=r"missing.img is not accepted: No such file"):
        module.main(["--read", str(tmp_path / "missing.img")])
    done = subprocess.run([sys.executable, str(DRIVER / "frame_image.py"), "--config", "v3", "--read", str(path)],
                          capture_output=True, text=True, check=False, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert done.returncode == 2 and done.stderr.startswith("error: image ") and done.stdout == ""


@needs_gcc
def test_a_frame_is_started_and_acknowledged(library: ctypes.CDLL, packed: bytes) -> None:
    registers, registers_of = Registers(library), Map(TINY)
    _, found, _ = opened(library, packed)
    registers.values[AT["status"]] = registers_of.value("status", done=1)[1]
    assert library.msv2_render(None, ctypes.byref(found), DRAM, 10, None) == OK
    causes = registers_of.value("interrupt", done=1, error=1)
    assert registers.written[-3:] == [
        causes, registers_of.value("control", start=1, enable_done=1, enable_error=1), causes]


@needs_gcc
def test_a_frame_that_fails_says_why(library: ctypes.CDLL) -> None:
    registers, failure = Registers(library), Words()
    registers.values |= {AT["status"]: Map(TINY).value("status", error=1)[1], AT["error"]: ErrorCode.BAD_SETTING,
                         AT["bad_setting"]: 29, AT["error_clients"]: 5}
    assert library.msv2_finish(None, 10, ctypes.byref(failure)) == FRAME_FAILED
    assert list(failure.words[:3]) == [ErrorCode.BAD_SETTING, AT["width"], 5]


@needs_gcc
@pytest.mark.parametrize(("status", "result"), [("error", TIMEOUT), ("done", OK), (None, TIMEOUT)])
def test_a_frame_that_takes_too_long_is_aborted(library: ctypes.CDLL, status: str | None, result: int) -> None:
    """Unless it was done just before the abort."""
    registers, registers_of = Registers(library), Map(TINY)
    registers.waits = [0, int(status is not None)]
    registers.values[AT["status"]] = registers_of.value("status", **({status: 1} if status else {}))[1]
    assert library.msv2_finish(None, 10, None) == result
    assert registers.written == [registers_of.value("control", abort=1, enable_done=1, enable_error=1),
                                 registers_of.value("interrupt", done=1, error=1)]


@needs_gcc
def test_counters(library: ctypes.CDLL) -> None:
    registers = Registers(library)
    registers.values |= {AT["cycles_total_low"]: 7, AT["cycles_total_high"]: 3, AT["pixels"]: 11, AT["fetch_misses"]: 13}
    library.msv2_count64.restype = ctypes.c_uint64
    assert library.msv2_count64(None, AT["cycles_total_low"]) == 3 << 32 | 7
    counted = Words()
    library.msv2_read_counters(None, ctypes.byref(counted))
    assert list(counted.words[:2]) == [7, 3] and list(counted.words[8 + 8 : 8 + 11]) == [11, 0, 13]
    supertiles = {register.name: register.offset for register in register_map(TINY_V3)}
    registers.values |= {AT["machine_array"]: identity(TINY_V3)["machine_array"], supertiles["header_hits"]: 17,
                         supertiles["header_misses"]: 19}
    library.msv2_read_counters(None, ctypes.byref(counted))
    assert list(counted.words[8 + 8 : 8 + 11]) == [11, 17, 19]
    library.msv2_clear_counters(None)
    assert registers.written == [Map(TINY).value("control", clear=1, enable_done=1, enable_error=1)]


def played(*options: str) -> subprocess.CompletedProcess:
    """The example's own run on the RTL. Its build is kept in build/examples/driver."""
    return subprocess.run([sys.executable, str(DRIVER / "frame.py"), "--out", str(BUILT), *options], capture_output=True,
                          text=True, check=False, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)})


@pytest.fixture(scope="module")
def simulated() -> subprocess.CompletedProcess:
    """A frame on the tiny machine."""
    return played()


@needs_gcc
@pytest.mark.long
def test_the_frame_on_the_rtl_is_the_golden_renderers(simulated: subprocess.CompletedProcess) -> None:
    """Minutes: a simulator of the tiny machine is built. The example compares pixels and counters."""
    assert simulated.returncode == 0 and " 0 values differ" in simulated.stdout, simulated.stdout + simulated.stderr
    assert f"machine {VERSION_MAJOR}." in simulated.stdout and "frames 1 " in simulated.stdout
    assert (BUILT / "tiny" / "frame0.png").is_file()


@needs_gcc
@pytest.mark.long
def test_frames_in_a_row_of_super_tiles_keep_their_bounds() -> None:
    """Minutes: a simulator is built. The second and the third frame have more lists than super-tiles, because of the bounds
    that the machine keeps from the frame before; without these the counted groups would be others."""
    done = played("--config", TINY_V3.name, "--frames", "3")
    assert done.returncode == 0, done.stdout + done.stderr
    lists = re.findall(r"frame \d: 48x48 pixels, \d+ intersections, (\d+) lists, 0 values differ", done.stdout)
    assert len(lists) == 3 and int(lists[0]) == 2 < min(map(int, lists[1:])), done.stdout


@needs_gcc
@pytest.mark.long
def test_joint_frames_of_two_eyes_are_packed_for_each() -> None:
    """Minutes: a simulator is built. Both eyes' frames are compared as they lie in memory, and as the unpacker gives them."""
    done = played("--config", "tiny_eyes_packed", "--frames", "2")
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(re.findall(r"frame \d: 48x48 pixels for each of two eyes, .* 0 values differ", done.stdout)) == 2, done.stdout
    assert f" pixels {2 * 48 * 48} " in done.stdout


@needs_gcc
@pytest.mark.long
@pytest.mark.parametrize(("word", "value", "timeout", "status", "said"), [
    (11 + 2 * 29 + 1, 0, "1000", FRAME_FAILED, "the frame failed: error 1, setting 0x174"),
    (None, 0, "0", TIMEOUT, "render: result 7"), (3, 1, "1000", OTHER_MACHINE, "load: result 4"),
    (0, 1, "1000", BAD_IMAGE, "image: result 3"), (1, 2, "1000", OTHER_IMAGE, "image: result 9"),
    (2, 2, "1000", OTHER_FORMAT, "load: result 10")],
    ids=["bad setting", "no time", "another machine", "no image", "another version", "another record format"])
def test_what_goes_wrong_on_the_rtl(
    word: int | None, value: int, timeout: str, status: int, said: str, simulated: subprocess.CompletedProcess, tmp_path: Path,
) -> None:
    words = np.fromfile(BUILT / "tiny" / "frame0.img", "<u4")
    if word is not None:
        words[word] = value
    words.tofile(tmp_path / "frame.img")
    done = subprocess.run([BUILT / "tiny" / "model" / "simulation", hex(DRAM), timeout, tmp_path / "frame.img",
                           tmp_path / "frame.bin"], capture_output=True, text=True, check=False)
    assert (done.returncode, said in done.stdout) == (status, True), done.stdout + done.stderr
    assert not (tmp_path / "frame.bin").exists()
