"""A stand-in for the machine, for tests of its testbench: copies the first beats of the geometry into the frame.

It has the machine's ports and registers, keeps many reads on their way, and does wrong what `beta` says.
"""

from __future__ import annotations

from pathlib import Path

from spec.codes import ErrorCode
from spec.config import AcceleratorConfig
from spec.registers import register_map
from tb.top.device import MODULE, Machine

STOPS, WITHDRAWS, MISALIGNS, STRAYS, OVERWRITES, WRONG_PIXEL = 1, 2, 3, 4, 5, 6
"""Faults."""

_TEXT = """\
module {module} (
  input clk, input rst, output interrupt,
  input [11:0] s_axil_awaddr, input [2:0] s_axil_awprot, input s_axil_awvalid, output s_axil_awready,
  input [31:0] s_axil_wdata, input [3:0] s_axil_wstrb, input s_axil_wvalid, output s_axil_wready,
  output [1:0] s_axil_bresp, output reg s_axil_bvalid, input s_axil_bready,
  input [11:0] s_axil_araddr, input [2:0] s_axil_arprot, input s_axil_arvalid, output s_axil_arready,
  output reg [31:0] s_axil_rdata, output [1:0] s_axil_rresp, output reg s_axil_rvalid, input s_axil_rready,
  output [1:0] m_axi_awid, output [31:0] m_axi_awaddr, output [7:0] m_axi_awlen, output [2:0] m_axi_awsize,
  output [1:0] m_axi_awburst, output m_axi_awvalid, input m_axi_awready,
  output [255:0] m_axi_wdata, output [31:0] m_axi_wstrb, output m_axi_wlast, output m_axi_wvalid, input m_axi_wready,
  input [1:0] m_axi_bid, input [1:0] m_axi_bresp, input m_axi_bvalid, output m_axi_bready,
  output [2:0] m_axi_arid, output [31:0] m_axi_araddr, output [7:0] m_axi_arlen, output [2:0] m_axi_arsize,
  output [1:0] m_axi_arburst, output m_axi_arvalid, input m_axi_arready,
  input [2:0] m_axi_rid, input [255:0] m_axi_rdata, input [1:0] m_axi_rresp, input m_axi_rlast, input m_axi_rvalid,
  output m_axi_rready
);
  reg [31:0] file [0:1023];
  integer preset;
  initial begin
    preset = $fopen("counters.hex", "r");
    if (preset != 0) $readmemh("counters.hex", file);
  end
  wire [31:0] geometry = file[{geometry_base}], frame = file[{frame_base}], fault = file[{beta}];
  wire [31:0] pixels = file[{width}] * file[{height}], beats = file[{display}][0] ? (pixels + 7) >> 3 : (pixels + 1) >> 1;
  reg busy, done, error, aborts, address_sent, data_sent;
  reg [31:0] asked, got, written, cycles, pending;
  reg [255:0] held;
  reg full;
  assign interrupt = (done | error) & file[{interrupt}][0];

  // Registers: a write takes both channels at once.
  assign s_axil_awready = s_axil_awvalid & s_axil_wvalid & ~s_axil_bvalid, s_axil_wready = s_axil_awready;
  assign s_axil_bresp = 0, s_axil_rresp = 0, s_axil_arready = ~s_axil_rvalid;
  wire [31:0] command = s_axil_awready & s_axil_awaddr == {control} * 4 ? s_axil_wdata : 0;

  assign m_axi_arvalid = busy & asked < beats & ~(fault == {withdraws} & cycles[0]);
  assign m_axi_araddr = fault == {strays} ? 32'hfffffe00 : (geometry + asked) << 5;
  assign m_axi_arid = 1, m_axi_arlen = 0, m_axi_arsize = 5, m_axi_arburst = 1;
  assign m_axi_rready = ~full & fault != {stops};
  wire move = (address_sent | m_axi_awready) & (data_sent | m_axi_wready) & full;
  assign m_axi_awvalid = full & ~address_sent, m_axi_wvalid = full & ~data_sent;
  assign m_axi_awaddr = fault == {overwrites} ? geometry << 5 : ((frame + written) << 5) + (fault == {misaligns} ? 4 : 0);
  assign m_axi_awid = 3, m_axi_awlen = 0, m_axi_awsize = 5, m_axi_awburst = 1;
  assign m_axi_wdata = held ^ (fault == {wrong_pixel} & written == 3), m_axi_wstrb = 32'hffffffff, m_axi_wlast = 1;
  assign m_axi_bready = 1;

  always @(posedge clk) begin
    if (s_axil_bready) s_axil_bvalid <= 0;
    if (s_axil_awready) begin
      file[s_axil_awaddr[11:2]] <= s_axil_wdata;
      s_axil_bvalid <= 1;
    end
    if (s_axil_rready) s_axil_rvalid <= 0;
    if (s_axil_arvalid & s_axil_arready) begin
      s_axil_rvalid <= 1;
      case (s_axil_araddr[11:2])
        {status}: s_axil_rdata <= {{29'd0, error, done, busy}};
        {error}: s_axil_rdata <= aborts ? {aborted} : error ? {read_error} : 0;
        {cycles_low}: s_axil_rdata <= cycles;
        {cycles_high}: s_axil_rdata <= 7;
        default: s_axil_rdata <= file[s_axil_araddr[11:2]];
      endcase
    end
    if (s_axil_awready & s_axil_awaddr == {interrupt} * 4) file[{interrupt}] <= 0;
    if (rst) begin
      busy <= 0; done <= 0; error <= 0; s_axil_bvalid <= 0; s_axil_rvalid <= 0; full <= 0; pending <= 0; aborts <= 0;
      address_sent <= 0; data_sent <= 0;
    end else begin
      if (busy) cycles <= cycles + 1;
      if (m_axi_arvalid & m_axi_arready) asked <= asked + 1;
      if (m_axi_rvalid & m_axi_rready) begin
        held <= m_axi_rdata;
        full <= busy;
        if (m_axi_rresp != 0) error <= 1;
        got <= got + 1;
      end
      if (full) begin
        address_sent <= ~move & (address_sent | m_axi_awready);
        data_sent <= ~move & (data_sent | m_axi_wready);
        if (move) begin
          full <= 0;
          written <= written + 1;
        end
      end
      pending <= pending + move - m_axi_bvalid;
      if (busy & (written == beats | error & got == asked & ~full) & pending == 0) begin
        busy <= 0;
        done <= ~error;
        file[{interrupt}] <= 1;
      end
      if (command[1] & busy) begin
        busy <= 0; error <= 1; aborts <= 1; file[{interrupt}] <= 1;
      end
      if (command[0]) begin
        busy <= 1; done <= 0; error <= 0; asked <= 0; got <= 0; written <= 0; cycles <= 0; aborts <= 0;
      end
    end
  end
endmodule
"""


def preset(config: AcceleratorConfig, folder: Path, counters: dict[str, int]) -> None:
    """What counters always read in simulations that run in `folder`."""
    words = {register.name: register.offset // 4 for register in register_map(config)}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "counters.hex").write_text("".join(f"@{words[name]:x} {value:x}\n" for name, value in counters.items()))


def stand_in(config: AcceleratorConfig) -> Machine:
    """The stand-in with the registers of a configuration."""
    words = {register.name: register.offset // 4 for register in register_map(config)}
    names = ("geometry_base", "frame_base", "beta", "display", "width", "height", "interrupt", "control", "status", "error")
    faults = {
        "stops": STOPS, "withdraws": WITHDRAWS, "misaligns": MISALIGNS, "strays": STRAYS, "overwrites": OVERWRITES,
        "wrong_pixel": WRONG_PIXEL}
    return Machine("stand-in", _TEXT.format(
        module=MODULE, **{name: words[name] for name in names}, **faults, cycles_low=words["cycles_total_low"],
        cycles_high=words["cycles_total_high"], aborted=int(ErrorCode.ABORTED), read_error=int(ErrorCode.READ_ERROR)))
