// A small system on chip: the accelerator and a port for a DMA engine or processor share one memory through an interconnect.
//
//   s_axil_*   the accelerator's registers, AXI4-Lite        m_axi (inside)   the accelerator ---.
//   dma_*      AXI4, of whoever fills and reads memory    ----------------------------------------+-- axi_memory
module system #(
  parameter BEATS = 4096
) (
  input  wire clk, rst,
  output wire interrupt,

  input  wire [11:0] s_axil_awaddr, input wire s_axil_awvalid, output wire s_axil_awready,
  input  wire [31:0] s_axil_wdata, input wire s_axil_wvalid, output wire s_axil_wready,
  output wire [1:0] s_axil_bresp, output wire s_axil_bvalid, input wire s_axil_bready,
  input  wire [11:0] s_axil_araddr, input wire s_axil_arvalid, output wire s_axil_arready,
  output wire [31:0] s_axil_rdata, output wire [1:0] s_axil_rresp, output wire s_axil_rvalid, input wire s_axil_rready,

  input  wire [31:0] dma_awaddr, input wire [7:0] dma_awlen, input wire dma_awvalid, output wire dma_awready,
  input  wire [255:0] dma_wdata, input wire dma_wlast, input wire dma_wvalid, output wire dma_wready,
  output wire dma_bvalid, input wire dma_bready,
  input  wire [31:0] dma_araddr, input wire [7:0] dma_arlen, input wire dma_arvalid, output wire dma_arready,
  output wire [255:0] dma_rdata, output wire dma_rlast, output wire dma_rvalid, input wire dma_rready
);
  localparam ID = 3;
  localparam [2:0] WHOLE = 5;  // beats of 32 bytes
  localparam [1:0] INCR = 1;

  wire [ID-1:0] awid, bid, arid, rid;
  wire [31:0] awaddr, araddr, wstrb;
  wire [7:0] awlen, arlen;
  wire [2:0] awsize, arsize;
  wire [1:0] awburst, arburst, bresp, rresp;
  wire [255:0] wdata, rdata;
  wire awvalid, awready, wvalid, wready, wlast, bvalid, bready, arvalid, arready, rvalid, rready, rlast;

  tiny_msv2_top accelerator (
    .clk(clk), .rst(rst), .interrupt(interrupt),
    .s_axil_awaddr(s_axil_awaddr), .s_axil_awprot(3'd0), .s_axil_awvalid(s_axil_awvalid), .s_axil_awready(s_axil_awready),
    .s_axil_wdata(s_axil_wdata), .s_axil_wstrb(4'hF), .s_axil_wvalid(s_axil_wvalid), .s_axil_wready(s_axil_wready),
    .s_axil_bresp(s_axil_bresp), .s_axil_bvalid(s_axil_bvalid), .s_axil_bready(s_axil_bready),
    .s_axil_araddr(s_axil_araddr), .s_axil_arprot(3'd0), .s_axil_arvalid(s_axil_arvalid), .s_axil_arready(s_axil_arready),
    .s_axil_rdata(s_axil_rdata), .s_axil_rresp(s_axil_rresp), .s_axil_rvalid(s_axil_rvalid), .s_axil_rready(s_axil_rready),
    .m_axi_awid(awid), .m_axi_awaddr(awaddr), .m_axi_awlen(awlen), .m_axi_awsize(awsize), .m_axi_awburst(awburst),
    .m_axi_awcache(), .m_axi_awprot(), .m_axi_awvalid(awvalid), .m_axi_awready(awready),
    .m_axi_wdata(wdata), .m_axi_wstrb(wstrb), .m_axi_wlast(wlast), .m_axi_wvalid(wvalid), .m_axi_wready(wready),
    .m_axi_bid(bid), .m_axi_bresp(bresp), .m_axi_bvalid(bvalid), .m_axi_bready(bready),
    .m_axi_arid(arid), .m_axi_araddr(araddr), .m_axi_arlen(arlen), .m_axi_arsize(arsize), .m_axi_arburst(arburst),
    .m_axi_arcache(), .m_axi_arprot(), .m_axi_arvalid(arvalid), .m_axi_arready(arready),
    .m_axi_rid(rid), .m_axi_rdata(rdata), .m_axi_rresp(rresp), .m_axi_rlast(rlast), .m_axi_rvalid(rvalid),
    .m_axi_rready(rready));

  wire [ID:0] s_awid, s_bid, s_arid, s_rid;
  wire [31:0] s_awaddr, s_araddr, s_wstrb;
  wire [7:0] s_arlen;
  wire [1:0] s_bresp, s_rresp;
  wire [255:0] s_wdata, s_rdata;
  wire s_awvalid, s_awready, s_wvalid, s_wready, s_wlast, s_bvalid, s_bready, s_arvalid, s_arready, s_rvalid, s_rready, s_rlast;

  axi_interconnect #(.ID(ID)) interconnect (
    .clk(clk), .rst(rst),
    .m0_awid(awid), .m0_awaddr(awaddr), .m0_awlen(awlen), .m0_awsize(awsize), .m0_awburst(awburst), .m0_awvalid(awvalid),
    .m0_awready(awready), .m0_wdata(wdata), .m0_wstrb(wstrb), .m0_wlast(wlast), .m0_wvalid(wvalid), .m0_wready(wready),
    .m0_bid(bid), .m0_bresp(bresp), .m0_bvalid(bvalid), .m0_bready(bready),
    .m0_arid(arid), .m0_araddr(araddr), .m0_arlen(arlen), .m0_arsize(arsize), .m0_arburst(arburst), .m0_arvalid(arvalid),
    .m0_arready(arready), .m0_rid(rid), .m0_rdata(rdata), .m0_rresp(rresp), .m0_rlast(rlast), .m0_rvalid(rvalid),
    .m0_rready(rready),
    .m1_awid(3'd0), .m1_awaddr(dma_awaddr), .m1_awlen(dma_awlen), .m1_awsize(WHOLE), .m1_awburst(INCR),
    .m1_awvalid(dma_awvalid), .m1_awready(dma_awready), .m1_wdata(dma_wdata), .m1_wstrb(32'hFFFFFFFF), .m1_wlast(dma_wlast),
    .m1_wvalid(dma_wvalid), .m1_wready(dma_wready), .m1_bid(), .m1_bresp(), .m1_bvalid(dma_bvalid), .m1_bready(dma_bready),
    .m1_arid(3'd0), .m1_araddr(dma_araddr), .m1_arlen(dma_arlen), .m1_arsize(WHOLE), .m1_arburst(INCR),
    .m1_arvalid(dma_arvalid), .m1_arready(dma_arready), .m1_rid(), .m1_rdata(dma_rdata), .m1_rresp(), .m1_rlast(dma_rlast),
    .m1_rvalid(dma_rvalid), .m1_rready(dma_rready),
    .s_awid(s_awid), .s_awaddr(s_awaddr), .s_awlen(), .s_awsize(), .s_awburst(), .s_awvalid(s_awvalid), .s_awready(s_awready),
    .s_wdata(s_wdata), .s_wstrb(s_wstrb), .s_wlast(s_wlast), .s_wvalid(s_wvalid), .s_wready(s_wready),
    .s_bid(s_bid), .s_bresp(s_bresp), .s_bvalid(s_bvalid), .s_bready(s_bready),
    .s_arid(s_arid), .s_araddr(s_araddr), .s_arlen(s_arlen), .s_arsize(), .s_arburst(), .s_arvalid(s_arvalid),
    .s_arready(s_arready), .s_rid(s_rid), .s_rdata(s_rdata), .s_rresp(s_rresp), .s_rlast(s_rlast), .s_rvalid(s_rvalid),
    .s_rready(s_rready));

  axi_memory #(.ID(ID + 1), .BEATS(BEATS)) memory (
    .clk(clk), .rst(rst),
    .awid(s_awid), .awaddr(s_awaddr), .awvalid(s_awvalid), .awready(s_awready),
    .wdata(s_wdata), .wstrb(s_wstrb), .wlast(s_wlast), .wvalid(s_wvalid), .wready(s_wready),
    .bid(s_bid), .bresp(s_bresp), .bvalid(s_bvalid), .bready(s_bready),
    .arid(s_arid), .araddr(s_araddr), .arlen(s_arlen), .arvalid(s_arvalid), .arready(s_arready),
    .rid(s_rid), .rdata(s_rdata), .rresp(s_rresp), .rlast(s_rlast), .rvalid(s_rvalid), .rready(s_rready));
endmodule
