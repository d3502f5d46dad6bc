// An AXI4 interconnect of two masters and one slave, small and slow, to show what stands around the accelerator.
//
// Both masters may send bursts and keep several reads under way. The slave sees one more ID bit, the highest, which says whose a
// transaction is, so that answers find their way back. A master waits at most for one transaction of the other (round robin).
// A write's data follow its address: the next address waits until the last beat of the write before it has passed.
module axi_interconnect #(
  parameter ADDR = 32, DATA = 256, ID = 4
) (
  input  wire clk, rst,

  // master 0
  input  wire [ID-1:0] m0_awid, input wire [ADDR-1:0] m0_awaddr, input wire [7:0] m0_awlen, input wire [2:0] m0_awsize,
  input  wire [1:0] m0_awburst, input wire m0_awvalid, output wire m0_awready,
  input  wire [DATA-1:0] m0_wdata, input wire [DATA/8-1:0] m0_wstrb, input wire m0_wlast, input wire m0_wvalid,
  output wire m0_wready,
  output wire [ID-1:0] m0_bid, output wire [1:0] m0_bresp, output wire m0_bvalid, input wire m0_bready,
  input  wire [ID-1:0] m0_arid, input wire [ADDR-1:0] m0_araddr, input wire [7:0] m0_arlen, input wire [2:0] m0_arsize,
  input  wire [1:0] m0_arburst, input wire m0_arvalid, output wire m0_arready,
  output wire [ID-1:0] m0_rid, output wire [DATA-1:0] m0_rdata, output wire [1:0] m0_rresp, output wire m0_rlast,
  output wire m0_rvalid, input wire m0_rready,

  // master 1
  input  wire [ID-1:0] m1_awid, input wire [ADDR-1:0] m1_awaddr, input wire [7:0] m1_awlen, input wire [2:0] m1_awsize,
  input  wire [1:0] m1_awburst, input wire m1_awvalid, output wire m1_awready,
  input  wire [DATA-1:0] m1_wdata, input wire [DATA/8-1:0] m1_wstrb, input wire m1_wlast, input wire m1_wvalid,
  output wire m1_wready,
  output wire [ID-1:0] m1_bid, output wire [1:0] m1_bresp, output wire m1_bvalid, input wire m1_bready,
  input  wire [ID-1:0] m1_arid, input wire [ADDR-1:0] m1_araddr, input wire [7:0] m1_arlen, input wire [2:0] m1_arsize,
  input  wire [1:0] m1_arburst, input wire m1_arvalid, output wire m1_arready,
  output wire [ID-1:0] m1_rid, output wire [DATA-1:0] m1_rdata, output wire [1:0] m1_rresp, output wire m1_rlast,
  output wire m1_rvalid, input wire m1_rready,

  // slave
  output wire [ID:0] s_awid, output wire [ADDR-1:0] s_awaddr, output wire [7:0] s_awlen, output wire [2:0] s_awsize,
  output wire [1:0] s_awburst, output wire s_awvalid, input wire s_awready,
  output wire [DATA-1:0] s_wdata, output wire [DATA/8-1:0] s_wstrb, output wire s_wlast, output wire s_wvalid,
  input  wire s_wready,
  input  wire [ID:0] s_bid, input wire [1:0] s_bresp, input wire s_bvalid, output wire s_bready,
  output wire [ID:0] s_arid, output wire [ADDR-1:0] s_araddr, output wire [7:0] s_arlen, output wire [2:0] s_arsize,
  output wire [1:0] s_arburst, output wire s_arvalid, input wire s_arready,
  input  wire [ID:0] s_rid, input wire [DATA-1:0] s_rdata, input wire [1:0] s_rresp, input wire s_rlast, input wire s_rvalid,
  output wire s_rready
);
  // Who has the read address channel: an offer that the slave has not taken yet must stay.
  reg ar_held, ar_owner, ar_next;
  wire ar = ar_held ? ar_owner : (ar_next ? m1_arvalid : !m0_arvalid);
  assign s_arvalid  = ar ? m1_arvalid : m0_arvalid;
  assign s_arid     = {ar, ar ? m1_arid : m0_arid};
  assign s_araddr   = ar ? m1_araddr : m0_araddr;
  assign s_arlen    = ar ? m1_arlen : m0_arlen;
  assign s_arsize   = ar ? m1_arsize : m0_arsize;
  assign s_arburst  = ar ? m1_arburst : m0_arburst;
  assign m0_arready = s_arready && !ar;
  assign m1_arready = s_arready && ar;
  always @(posedge clk) begin
    if (rst) begin
      ar_held <= 0;
      ar_owner <= 0;
      ar_next <= 0;
    end else if (s_arvalid) begin
      ar_held <= !s_arready;
      ar_owner <= ar;
      if (s_arready) ar_next <= !ar;
    end
  end

  assign {m0_rid, m0_rdata, m0_rresp, m0_rlast} = {s_rid[ID-1:0], s_rdata, s_rresp, s_rlast};
  assign {m1_rid, m1_rdata, m1_rresp, m1_rlast} = {s_rid[ID-1:0], s_rdata, s_rresp, s_rlast};
  assign m0_rvalid = s_rvalid && !s_rid[ID];
  assign m1_rvalid = s_rvalid && s_rid[ID];
  assign s_rready  = s_rid[ID] ? m1_rready : m0_rready;

  // Writes: `w_busy` from an address until the last beat of its data; `w_owner` says whose data they are.
  reg aw_held, aw_owner, aw_next, w_busy, w_owner;
  wire aw = aw_held ? aw_owner : (aw_next ? m1_awvalid : !m0_awvalid);
  assign s_awvalid  = !w_busy && (aw ? m1_awvalid : m0_awvalid);
  assign s_awid     = {aw, aw ? m1_awid : m0_awid};
  assign s_awaddr   = aw ? m1_awaddr : m0_awaddr;
  assign s_awlen    = aw ? m1_awlen : m0_awlen;
  assign s_awsize   = aw ? m1_awsize : m0_awsize;
  assign s_awburst  = aw ? m1_awburst : m0_awburst;
  assign m0_awready = !w_busy && s_awready && !aw;
  assign m1_awready = !w_busy && s_awready && aw;
  assign s_wdata    = w_owner ? m1_wdata : m0_wdata;
  assign s_wstrb    = w_owner ? m1_wstrb : m0_wstrb;
  assign s_wlast    = w_owner ? m1_wlast : m0_wlast;
  assign s_wvalid   = w_busy && (w_owner ? m1_wvalid : m0_wvalid);
  assign m0_wready  = w_busy && s_wready && !w_owner;
  assign m1_wready  = w_busy && s_wready && w_owner;
  always @(posedge clk) begin
    if (rst) begin
      aw_held <= 0;
      aw_owner <= 0;
      aw_next <= 0;
      w_busy <= 0;
      w_owner <= 0;
    end else begin
      if (s_awvalid) begin
        aw_held <= !s_awready;
        aw_owner <= aw;
        if (s_awready) begin
          aw_next <= !aw;
          w_busy <= 1;
          w_owner <= aw;
        end
      end
      if (s_wvalid && s_wready && s_wlast) w_busy <= 0;
    end
  end

  assign {m0_bid, m0_bresp} = {s_bid[ID-1:0], s_bresp};
  assign {m1_bid, m1_bresp} = {s_bid[ID-1:0], s_bresp};
  assign m0_bvalid = s_bvalid && !s_bid[ID];
  assign m1_bvalid = s_bvalid && s_bid[ID];
  assign s_bready  = s_bid[ID] ? m1_bready : m0_bready;
endmodule
