"""A memory model for the memory ports of a unit. It answers late and irregularly, within the rules that a unit must cope with.

`with_memory` wraps a unit together with this memory, so that `Playback` sees the remaining ports. A write becomes visible
`latency` cycles after it was accepted. `writes_idle` is low from the cycle after a write was accepted until all writes are
visible. A read returns the memory's content either at the time when it was accepted (`early`) or at the time when it is
answered: a unit must be correct in both cases.
"""

from __future__ import annotations

from dataclasses import replace

from spec.memory import BEAT_BITS
from tb.common.playback import Playback

SETTINGS = (("latency", 10), ("read_pauses", 8), ("write_pauses", 8), ("early", 1), ("bad_beat", 28),
            ("region", BEAT_BITS), ("region_beats", BEAT_BITS))
"""Additional plain inputs of the wrapper, with their widths. `latency`: cycles until an answer and until a write is visible.
`read_pauses`, `write_pauses`: the share of cycles, in 256ths, in which reads or writes pause; accepting and answering pause
independently. `early`: when reads look at the memory. `bad_beat`: a beat whose reads are answered with an error. `region`,
`region_beats`: the first beat and the size of the memory that the unit may use."""

OBSERVED = (("astray", 1),)
"""Additional plain outputs. `astray`: a read or a write was outside the region, since the last reset."""

NO_BAD_BEAT = 1 << 27
"""The value of `bad_beat` for a memory without a faulty beat."""

_QUEUE = 2048
"""Largest number of reads, and of writes, in flight."""

_MEMORY = """\
module memory_model (
  input clk, input rst, input [9:0] latency, input [7:0] read_pauses, input [7:0] write_pauses, input early,
  input [27:0] bad_beat, input [26:0] region, input [26:0] region_beats, output reg astray = 0,
  input [26:0] reads__payload, input reads__valid, output reads__ready,
  output reg [256:0] data__payload = 0, output reg data__valid = 0, input data__ready,
  input [290:0] writes__payload, input writes__valid, output writes__ready, output writes_idle
);
  reg [255:0] ram [0:(1<<{bits})-1];
  // Higher bits of an address are not ignored, so that one that is wrong is noticed.
  function [{bits}-1:0] place(input [26:0] beat);
    place = beat[{bits}-1:0] ^ {{{low_zeros}, beat[26:{bits}]}};
  endfunction
  reg [31:0] now = 0, chance = 1;
  wire [31:0] once = chance ^ (chance << 13), twice = once ^ (once >> 17);
  always @(posedge clk) begin
    now <= now + 1;
    chance <= twice ^ (twice << 5);
  end
  wire [26:0] read_at = reads__payload - region, write_at = writes__payload[26:0] - region;
  always @(posedge clk)
    if (rst) astray <= 0;
    else if (reads__valid & read_at >= region_beats | writes__valid & write_at >= region_beats) astray <= 1;
  // Reads wait with their address, their time and what was there when they were taken.
  reg [26:0] asked [0:{queue}-1];
  reg [31:0] asked_at [0:{queue}-1];
  reg [255:0] seen [0:{queue}-1];
  reg [{top}:0] asks = 0, answers = 0;
  wire [{top}:0] asking = asks - answers;
  wire [{low}:0] newest = asks[{low}:0], oldest = answers[{low}:0];
  wire answering = asking != 0 && now - asked_at[oldest] >= {{22'b0, latency}} && chance[15:8] >= read_pauses;
  assign reads__ready = ~asking[{top}] & chance[7:0] >= read_pauses;
  always @(posedge clk) begin
    if (rst) begin
      asks <= 0;
      answers <= 0;
      data__valid <= 0;
    end else begin
      if (reads__valid & reads__ready) begin
        asked[newest] <= reads__payload;
        asked_at[newest] <= now;
        seen[newest] <= ram[place(reads__payload)];
        asks <= asks + 1;
      end
      if (~data__valid | data__ready) begin
        data__valid <= answering;
        data__payload <= {{{{1'b0, asked[oldest]}} == bad_beat, early ? seen[oldest] : ram[place(asked[oldest])]}};
        if (answering) answers <= answers + 1;
      end
    end
  end
  // Writes wait with their time.
  reg [290:0] given [0:{queue}-1];
  reg [31:0] given_at [0:{queue}-1];
  reg [{top}:0] gifts = 0, stored = 0;
  wire [{top}:0] giving = gifts - stored;
  wire [{low}:0] latest = gifts[{low}:0], first = stored[{low}:0];
  wire [290:0] next = given[first];
  wire storing = giving != 0 && now - given_at[first] >= {{22'b0, latency}} && chance[31:24] >= write_pauses;
  assign writes__ready = ~giving[{top}] & chance[23:16] >= write_pauses;
  assign writes_idle = giving == 0;
  integer i;
  always @(posedge clk) begin
    if (rst) begin
      gifts <= 0;
      stored <= 0;
    end else begin
      if (writes__valid & writes__ready) begin
        given[latest] <= writes__payload;
        given_at[latest] <= now;
        gifts <= gifts + 1;
      end
      if (storing) begin
        for (i = 0; i < 8; i = i + 1) if (next[283 + i]) ram[place(next[26:0])][32 * i +: 32] <= next[27 + 32 * i +: 32];
        stored <= stored + 1;
      end
    end
  end
endmodule
"""

_PORTS = (("reads__payload", 27), ("reads__valid", 1), ("reads__ready", 1), ("data__payload", 257), ("data__valid", 1),
          ("data__ready", 1), ("writes__payload", 291), ("writes__valid", 1), ("writes__ready", 1), ("writes_idle", 1))


def with_memory(playback: Playback, bits: int) -> Playback:
    """The unit with a memory of 1 << bits beats connected to `reads`, `data`, `writes` and `writes_idle`, and with the
    additional settings SETTINGS and outputs OBSERVED.

    A region of at most half the memory may lie anywhere: the higher bits of an address are added, without carry, to the lowest
    ones.

    Raises:
        ValueError: `bits` is not in 14..26.
    """
    if not BEAT_BITS <= 2 * bits < 2 * BEAT_BITS:
        raise ValueError(f"bits must be in {-(-BEAT_BITS // 2)}..{BEAT_BITS - 1}, not {bits!r}")
    name = f"{playback.module}_with_memory"
    ports, passed = ["input clk", "input rst"], ["clk", "rst"]
    for stream, (there, back) in (
            *((s, ("input", "output")) for s in playback.inputs), *((s, ("output", "input")) for s in playback.outputs)):
        ports += [f"{there} [{stream.record.width - 1}:0] {stream.name}__payload", f"{there} {stream.name}__valid",
                  f"{back} {stream.name}__ready"]
        passed += [f"{stream.name}__{wire}" for wire in ("payload", "valid", "ready")]
    ports += [f"input [{width - 1}:0] {port}" for port, width in (*playback.settings, *SETTINGS)]
    ports += [f"output [{width - 1}:0] {port}" for port, width in (*playback.observed, *OBSERVED)]
    passed += [port for port, _ in (*playback.settings, *playback.observed)]
    wires = [port for port, _ in _PORTS]
    top = "\n".join([
        f"module {name} (", ",\n".join(f"  {port}" for port in ports), ");",
        *(f"  wire [{width - 1}:0] {port};" for port, width in _PORTS),
        _instance(playback.module, "unit", [*passed, *wires]),
        _instance("memory_model", "memory", ["clk", "rst", *(port for port, _ in (*SETTINGS, *OBSERVED)), *wires]),
        "endmodule\n"])
    low = (_QUEUE - 1).bit_length() - 1
    zeros = f"{2 * bits - BEAT_BITS}'b0"
    memory = _MEMORY.format(bits=bits, queue=_QUEUE, top=low + 1, low=low, low_zeros=zeros)
    return replace(
        playback, name=f"{playback.name}-memory-{bits}", module=name, verilog="\n".join([playback.verilog, memory, top]),
        settings=(*playback.settings, *SETTINGS), observed=(*playback.observed, *OBSERVED))


def _instance(module: str, name: str, ports: list[str]) -> str:
    return f"  {module} {name} ({', '.join(f'.{port}({port})' for port in ports)});"
