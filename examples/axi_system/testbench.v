// One frame in the system: a DMA engine fills memory in bursts, the host writes the registers and starts the accelerator, and at
// the interrupt the DMA engine reads the frame back. `frame.py` writes the inputs and compares what comes out.
//
//   image.hex    beats of memory, "@place" before each stretch that the host fills; beats of all X are left alone
//   writes.hex   registers to write, address and value in one word of 64 bits, the start last
//   frame.hex    what is read back
module testbench;
  parameter BEATS = 4096, WRITES = 64, FRAME_BASE = 0, FRAME_BEATS = 16, PATIENCE = 200000;
  localparam BURST = 4;

  reg clk = 0, rst = 1;
  always #5 clk = ~clk;
  wire interrupt;

  reg  [11:0] awaddr = 0;
  reg  [31:0] wdata = 0;
  reg  awvalid = 0, wvalid = 0;
  wire awready, wready, bvalid;
  wire [1:0] bresp;
  reg  [31:0] dma_awaddr = 0, dma_araddr = 0;
  reg  [255:0] dma_wdata = 0;
  reg  dma_awvalid = 0, dma_wvalid = 0, dma_wlast = 0, dma_arvalid = 0;
  wire dma_awready, dma_wready, dma_bvalid, dma_arready, dma_rvalid, dma_rlast;
  wire [255:0] dma_rdata;

  system #(.BEATS(BEATS)) system (
    .clk(clk), .rst(rst), .interrupt(interrupt),
    .s_axil_awaddr(awaddr), .s_axil_awvalid(awvalid), .s_axil_awready(awready), .s_axil_wdata(wdata),
    .s_axil_wvalid(wvalid), .s_axil_wready(wready), .s_axil_bresp(bresp), .s_axil_bvalid(bvalid), .s_axil_bready(1'b1),
    .s_axil_araddr(12'd0), .s_axil_arvalid(1'b0), .s_axil_arready(), .s_axil_rdata(), .s_axil_rresp(), .s_axil_rvalid(),
    .s_axil_rready(1'b1),
    .dma_awaddr(dma_awaddr), .dma_awlen(8'd3), .dma_awvalid(dma_awvalid), .dma_awready(dma_awready),
    .dma_wdata(dma_wdata), .dma_wlast(dma_wlast), .dma_wvalid(dma_wvalid), .dma_wready(dma_wready),
    .dma_bvalid(dma_bvalid), .dma_bready(1'b1),
    .dma_araddr(dma_araddr), .dma_arlen(8'd3), .dma_arvalid(dma_arvalid), .dma_arready(dma_arready),
    .dma_rdata(dma_rdata), .dma_rlast(dma_rlast), .dma_rvalid(dma_rvalid), .dma_rready(1'b1));

  reg [255:0] image [0:BEATS-1];
  reg [63:0] writes [0:WRITES-1];
  integer place, beat, k, file, cycles, begun;

  // A burst of BURST beats of the image to memory.
  task dma_write(input integer first);
    begin
      dma_awaddr <= first * 32;
      dma_awvalid <= 1;
      @(posedge clk);
      while (!dma_awready) @(posedge clk);
      dma_awvalid <= 0;
      for (k = 0; k < BURST; k = k + 1) begin
        dma_wdata <= image[first + k];
        dma_wlast <= k == BURST - 1;
        dma_wvalid <= 1;
        @(posedge clk);
        while (!dma_wready) @(posedge clk);
      end
      dma_wvalid <= 0;
      while (!dma_bvalid) @(posedge clk);
    end
  endtask

  task register_write(input [11:0] address, input [31:0] value);
    begin
      awaddr <= address;
      wdata <= value;
      awvalid <= 1;
      wvalid <= 1;
      @(posedge clk);
      while (awvalid || wvalid) begin
        if (awready) awvalid <= 0;
        if (wready) wvalid <= 0;
        @(posedge clk);
      end
      while (!bvalid) @(posedge clk);
      if (bresp !== 0) $display("FAIL: register 0x%03x answers %0d", address, bresp);
    end
  endtask

  initial begin
    $readmemh("image.hex", image);
    $readmemh("writes.hex", writes);
    repeat (4) @(posedge clk);
    rst <= 0;
    @(posedge clk);
    for (place = 0; place < BEATS; place = place + BURST)
      if (^image[place] !== 1'bx) dma_write(place);
    $display("memory is filled");
    for (place = 0; place < WRITES; place = place + 1) register_write(writes[place][43:32], writes[place][31:0]);
    begun = cycles;
    while (interrupt !== 1'b1 && cycles - begun < PATIENCE) @(posedge clk);
    if (interrupt !== 1'b1) $display("FAIL: no interrupt after %0d cycles", PATIENCE);
    else $display("interrupt after %0d cycles", cycles - begun);
    file = $fopen("frame.hex", "w");
    for (place = 0; place < FRAME_BEATS; place = place + BURST) begin
      dma_araddr <= (FRAME_BASE + place) * 32;
      dma_arvalid <= 1;
      @(posedge clk);
      while (!dma_arready) @(posedge clk);
      dma_arvalid <= 0;
      beat = 0;
      while (beat < BURST) begin
        @(posedge clk);
        if (dma_rvalid) begin
          $fdisplay(file, "%064x", dma_rdata);
          beat = beat + 1;
        end
      end
    end
    $fclose(file);
    $finish;
  end

  initial cycles = 0;
  always @(posedge clk) cycles <= cycles + 1;
endmodule
