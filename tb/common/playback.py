"""A Verilog testbench that surrounds a unit and reads and writes files. Python only starts the simulation and waits for it.

Driving ports from Python costs an event per cycle and port. Here a thin Verilog wrapper reads one line of a file per item,
pauses according to the tables of `tb.common.patterns`, and writes the outputs to files, so that the simulation runs at the
simulator's own speed. Since stimuli are files, one build serves every scene. `tb.common.player` is the Python side.
"""

from __future__ import annotations

from dataclasses import dataclass

from spec.records import Record
from tb.common.patterns import PERIOD
from tb.common.runner import Design

ERRORS = {
    1: "a payload changed, or was withdrawn, while valid and not ready",
    2: "no item moved for the length of the watchdog",
    4: "more items came out than expected",
    8: "input was left over",
    16: "`busy` was low while an item was offered, or one came out that nothing had come in for since",
}
"""Meanings of the bits of the wrapper's output `errors`."""

_STATIC_PORTS = {"rst": 1, "active": 1, "run": 32, "quiet": 32, "watchdog": 32}


@dataclass(frozen=True)
class Stream:
    """A stream port of the unit: the name of its Amaranth interface and what it carries."""

    name: str
    record: Record


@dataclass(frozen=True)
class Playback:
    """A unit under test and its ports.

    Attributes:
        name: the name of the build folder.
        module: the unit's Verilog module, with ports clk, rst, and `NAME__payload`, `NAME__valid`, `NAME__ready`.
        verilog: the module's Verilog text.
        inputs: its input streams.
        outputs: its output streams.
        settings: (port, bits) of plain inputs, which are constant during a run.
        observed: (port, bits) of plain outputs, which are read at the end of a run. `busy` is also watched in every cycle: it
            must be high while an item is offered, and where it is low and nothing is offered at the inputs, nothing may come
            out before something is.
        apart: modules that Verilator does not inline (see `runner.Design`).
        busy_watched: False where the unit's `busy` does not tell whether something is inside.
    """

    name: str
    module: str
    verilog: str
    inputs: tuple[Stream, ...]
    outputs: tuple[Stream, ...]
    settings: tuple[tuple[str, int], ...] = ()
    observed: tuple[tuple[str, int], ...] = ()
    apart: tuple[str, ...] = ()
    busy_watched: bool = True

    def design(self) -> Design:
        """The unit with its wrapper, ready to build."""
        counters = [f"{s.name}_{what}" for s in (*self.inputs, *self.outputs) for what in ("items", "stalls")]
        limits = [f"{s.name}_limit" for s in self.outputs]
        plain = [name for name, _ in (*self.settings, *self.observed)]
        public = ("clk", *_STATIC_PORTS, *plain, *limits, *counters, "cycles", "over", "errors")
        return Design(self.name, "tb", (("dut.v", self.verilog), ("tb.sv", _wrapper(self))), public, self.apart)


_SOURCE = """
  // Source of {name}: an item stays until it is taken, the next follows unless the table says pause.
  reg [{top}:0] {name}_data, {name}_next;
  reg {name}_valid = 0, {name}_ended = 0;
  wire {name}_ready;
  reg [31:0] {name}_sent = 0, {name}_waits = 0;
  integer {name}_file = 0;
  reg {name}_pause [0:{period}-1];
  assign {name}_items = {name}_sent;
  assign {name}_stalls = {name}_waits;
  always @(posedge clk) begin
    if (begins) begin
      $sformat(path, "%0s/%0d/{name}.pauses", folder, run);
      $readmemb(path, {name}_pause);
      if ({name}_file != 0) $fclose({name}_file);
      $sformat(path, "%0s/%0d/{name}.hex", folder, run);
      {name}_file = $fopen(path, "r");
      if ({name}_file == 0) $fatal(1, "cannot read %0s", path);
      {name}_sent <= 0;
      {name}_waits <= 0;
      {name}_ended <= 0;
    end
    if (rst | begins) {name}_valid <= 0;
    else if (running & (~{name}_valid | {name}_ready)) begin
      if ({name}_valid) {name}_sent <= {name}_sent + 1;
      if ({name}_ended | {name}_pause[phase]) {name}_valid <= 0;
      else if ($fscanf({name}_file, "%h", {name}_next) == 1) begin
        {name}_data <= {name}_next;
        {name}_valid <= 1;
      end else begin
        {name}_valid <= 0;
        {name}_ended <= 1;
      end
    end else if (running) {name}_waits <= {name}_waits + 1;
  end
"""

_SINK = """
  // Sink of {name}: writes what it takes, and checks that the unit holds what it has offered.
  wire [{top}:0] {name}_data;
  reg [{top}:0] {name}_held;
  wire {name}_valid;
  reg {name}_ready = 0, {name}_waiting = 0;
  reg [31:0] {name}_taken = 0, {name}_waits = 0;
  integer {name}_file = 0;
  reg {name}_pause [0:{period}-1];
  wire {name}_moves = {name}_valid & {name}_ready & running;
  wire {name}_broken = {name}_waiting & (~{name}_valid | ({name}_data != {name}_held));
  assign {name}_items = {name}_taken;
  assign {name}_stalls = {name}_waits;
  always @(posedge clk) begin
    if (begins) begin
      $sformat(path, "%0s/%0d/{name}.pauses", folder, run);
      $readmemb(path, {name}_pause);
      if ({name}_file != 0) $fclose({name}_file);
      $sformat(path, "%0s/%0d/{name}.out", folder, run);
      {name}_file = $fopen(path, "w");
      if ({name}_file == 0) $fatal(1, "cannot write %0s", path);
      {name}_taken <= 0;
      {name}_waits <= 0;
    end
    if ({name}_moves) begin
      $fwrite({name}_file, "%h\\n", {name}_data);
      {name}_taken <= {name}_taken + 1;
    end
    if (running & {name}_valid & ~{name}_ready) {name}_waits <= {name}_waits + 1;
    if (ends) $fflush({name}_file);
    {name}_ready <= running & ~rst & ~{name}_pause[phase];
    {name}_held <= {name}_data;
    {name}_waiting <= {name}_valid & ~{name}_ready & ~rst;
  end
"""

_FRAME = """\
// Generated by tb/common/playback.py: {module} between files.
module tb ({ports}
);
  string folder, path;
  initial if (!$value$plusargs("folder=%s", folder)) folder = ".";

  // A run lasts from the rise of `active` until `quiet` cycles after the last expected item; `ends` is its last cycle. An
  // output that gives far more items than expected ends it, too: a unit that emits for ever would otherwise never end.
  reg active_before = 0;
  wire begins = active & ~active_before;
  wire running = active & active_before & ~over;
  wire moves = {moves};
  wire complete = {complete};
  wire ended = {ended};
  reg [31:0] idle = 0, cycle = 0;
  wire flooded = {flooded};
  wire ends = running & (flooded | idle >= (complete & ended ? quiet : watchdog));
  reg [12:0] phase = 0;
  always @(posedge clk) begin
    active_before <= active;
    phase <= phase == {period} - 1 ? 0 : phase + 1;
    if (begins) begin
      over <= 0;
      errors <= 0;
      cycle <= 0;
      cycles <= 0;
      idle <= 0;
      phase <= 0;
    end else if (running) begin
      cycle <= cycle + 1;
      idle <= moves ? 0 : idle + 1;
      if (moves) cycles <= cycle + 1;
      errors <= errors | (broken ? 1 : 0) | (ends & ~complete ? 2 : 0) | (excess ? 4 : 0) | (ends & ~ended ? 8 : 0)
        | (denied ? 16 : 0);
      if (ends) over <= 1;
    end
  end
  wire broken = {broken};
  wire excess = {excess};
  // A unit that says it is not busy has nothing inside.
  reg empty = 0;
  wire fed = {fed}, offers = {offers};
  wire denied = offers & (empty | ~{busy});
  always @(posedge clk) empty <= running & ~rst & ~fed & (empty | ~{busy});
{streams}
  {module} dut (
    .clk(clk), .rst(rst){connections}
  );
endmodule
"""


def _wrapper(playback: Playback) -> str:
    inputs, outputs = [s.name for s in playback.inputs], [s.name for s in playback.outputs]
    names = inputs + outputs
    driven = {"clk": 1, **_STATIC_PORTS, **dict(playback.settings), **{f"{name}_limit": 32 for name in outputs}}
    ports = [f"input [{width - 1}:0] {name}" for name, width in driven.items()]
    ports += [f"output [31:0] {name}_{what}" for name in names for what in ("items", "stalls")]
    ports += [f"output [{width - 1}:0] {name}" for name, width in playback.observed]
    ports += ["output reg [31:0] cycles = 0", "output reg over = 0", "output reg [4:0] errors = 0"]
    streams = [
        template.format(name=s.name, top=s.record.width - 1, period=PERIOD)
        for template, group in ((_SOURCE, playback.inputs), (_SINK, playback.outputs)) for s in group]
    connections = [f".{name}({name})" for name, _ in (*playback.settings, *playback.observed)]
    connections += [
        f".{name}__{port}({name}_{wire})" for name in names
        for port, wire in (("payload", "data"), ("valid", "valid"), ("ready", "ready"))]
    return _FRAME.format(
        module=playback.module, period=PERIOD, streams="".join(streams),
        ports=",".join("\n  " + port for port in ports), connections="".join(",\n    " + c for c in connections),
        moves=" | ".join(f"({n}_valid & {n}_ready)" for n in names),
        complete=" & ".join(f"({n}_taken >= {n}_limit)" for n in outputs),
        ended=" & ".join(f"({n}_ended & ~{n}_valid)" for n in inputs) or "1'b1",
        broken=" | ".join(f"{n}_broken" for n in outputs),
        flooded=" | ".join(f"({n}_taken > {n}_limit + (watchdog << 6))" for n in outputs),
        excess=" | ".join(f"({n}_moves & {n}_taken >= {n}_limit)" for n in outputs),
        fed=" | ".join(f"{n}_valid" for n in inputs) or "1'b1", offers=" | ".join(f"{n}_valid" for n in outputs),
        busy="busy" if playback.busy_watched and ("busy", 1) in playback.observed else "1'b1",
    )
