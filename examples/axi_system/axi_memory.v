// A memory behind AXI4: incrementing bursts of whole beats, one read and one write under way at a time, a beat a cycle.
// It begins with garbage, as a DRAM does.
module axi_memory #(
  parameter ADDR = 32, DATA = 256, ID = 5, BEATS = 4096
) (
  input  wire clk, rst,
  input  wire [ID-1:0] awid, input wire [ADDR-1:0] awaddr, input wire awvalid, output wire awready,
  input  wire [DATA-1:0] wdata, input wire [DATA/8-1:0] wstrb, input wire wlast, input wire wvalid, output wire wready,
  output reg  [ID-1:0] bid, output wire [1:0] bresp, output reg bvalid, input wire bready,
  input  wire [ID-1:0] arid, input wire [ADDR-1:0] araddr, input wire [7:0] arlen, input wire arvalid, output wire arready,
  output reg  [ID-1:0] rid, output wire [DATA-1:0] rdata, output wire [1:0] rresp, output wire rlast, output wire rvalid,
  input  wire rready
);
  localparam LOW = $clog2(DATA / 8), PLACE = $clog2(BEATS);
  reg [DATA-1:0] cells [0:BEATS-1];
  integer i;
  initial for (i = 0; i < BEATS; i = i + 1) cells[i] = {(DATA / 32){32'hDEADBEEF ^ i}};

  reg read_busy;
  reg [PLACE-1:0] read_place;
  reg [7:0] read_left;
  assign rvalid = read_busy;
  assign rdata = cells[read_place];
  assign rresp = 0;
  assign rlast = read_left == 0;
  assign arready = !read_busy || (rlast && rready);
  always @(posedge clk) begin
    if (rst) read_busy <= 0;
    else if (arvalid && arready) begin
      read_busy <= 1;
      rid <= arid;
      read_place <= araddr[LOW +: PLACE];
      read_left <= arlen;
    end else if (read_busy && rready) begin
      read_busy <= !rlast;
      read_place <= read_place + 1'b1;
      read_left <= read_left - 1'b1;
    end
  end

  reg write_busy;
  reg [PLACE-1:0] write_place;
  assign bresp = 0;
  assign awready = !write_busy && !bvalid;
  assign wready = write_busy;
  always @(posedge clk) begin
    if (rst) begin
      write_busy <= 0;
      bvalid <= 0;
    end else begin
      if (bready) bvalid <= 0;
      if (awvalid && awready) begin
        write_busy <= 1;
        bid <= awid;
        write_place <= awaddr[LOW +: PLACE];
      end
      if (wvalid && wready) begin
        for (i = 0; i < DATA / 8; i = i + 1)
          if (wstrb[i]) cells[write_place][8*i +: 8] <= wdata[8*i +: 8];
        write_place <= write_place + 1'b1;
        if (wlast) begin
          write_busy <= 0;
          bvalid <= 1;
        end
      end
    end
  end
endmodule
