// The tile merge unit alone, in a testbench of plain Verilog-2001: nothing here knows Python or Amaranth.
//
// A frame of 6 x 2 tiles gets intersections in no particular order. The unit counts them by tile and merges neighbouring tiles
// into groups while a group stays below the threshold beta. The testbench checks every count, that tiles come in order, and
// that groups are numbered from 0 without a gap; it prints each tile's group, and PASS or FAIL at the end.
module testbench;
  localparam TILES_X = 6, TILES = 12, HITS = 40, BETA = 8;

  reg clk = 0, rst = 1;
  always #5 clk = ~clk;

  reg  [10:0] hit = 0;
  reg         hit_valid = 0;
  wire        hit_ready;
  wire [44:0] group;
  wire        group_valid;
  reg         group_ready = 0;
  wire        busy, saturated, outside;

  tiny_tile_merge_unit unit (
    .clk(clk), .rst(rst),
    .hits__payload(hit), .hits__valid(hit_valid), .hits__ready(hit_ready),
    .groups__payload(group), .groups__valid(group_valid), .groups__ready(group_ready),
    .tiles_x(11'd6), .tile_count(11'd12), .beta(24'd8), .auto(1'b0),
    .beta_used(), .saturated(saturated), .outside(outside), .busy(busy));

  // The fields of a TileGroup, as the head of tiny_tile_merge_unit.v lists them.
  wire [9:0]  tile   = group[9:0];
  wire [23:0] count  = group[33:10];
  wire [9:0]  number = group[43:34];
  wire        last   = group[44];

  integer counts [0:TILES-1];
  integer seen = 0, errors = 0, next_group = 0, i;
  reg [31:0] random = 32'h2545F491;

  task give(input [10:0] item);
    begin
      hit <= item;
      hit_valid <= 1;
      @(posedge clk);
      while (!hit_ready) @(posedge clk);
      hit_valid <= 0;
    end
  endtask

  initial begin
    for (i = 0; i < TILES; i = i + 1) counts[i] = 0;
    repeat (3) @(posedge clk);
    rst <= 0;
    @(posedge clk);
    while (busy !== 1'b0) @(posedge clk);  // the counters are cleared once after a reset
    for (i = 0; i < HITS; i = i + 1) begin
      random = random * 32'd1664525 + 32'd1013904223;
      counts[(random >> 20) % TILES] = counts[(random >> 20) % TILES] + 1;
      give((random >> 20) % TILES);
    end
    give(11'h400);  // `end`: all intersections of the frame have come
    repeat (2000) @(posedge clk);
    $display("FAIL: %0d of %0d tiles after 2000 cycles", seen, TILES);
    $finish;
  end

  // The receiver is ready in two of three cycles.
  integer cycle = 0;
  always @(posedge clk) begin
    cycle <= cycle + 1;
    group_ready <= cycle % 3 != 0;
    if (!rst && group_valid && group_ready) begin
      $display("tile %0d count %0d group %0d%s", tile, count, number, last ? " last" : "");
      if (tile !== seen || count !== counts[seen]) begin
        $display("FAIL: tile %0d must have count %0d, not %0d", seen, counts[seen], count);
        errors = errors + 1;
      end
      if (last) begin
        if (number !== next_group) errors = errors + 1;
        next_group = next_group + 1;
      end
      seen = seen + 1;
      if (seen == TILES) begin
        if (saturated !== 0 || outside !== 0) errors = errors + 1;
        $display("%s: %0d tiles in %0d groups, %0d errors", errors ? "FAIL" : "PASS", seen, next_group, errors);
        $finish;
      end
    end
  end
endmodule
