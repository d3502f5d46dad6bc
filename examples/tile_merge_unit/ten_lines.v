module ten_lines;
  reg clk = 0, rst = 1; always #5 clk = ~clk; initial begin #20 rst = 0; #20000 $finish; end
  integer n = 0; wire ready, valid; wire [44:0] group;
  wire [10:0] hit = n < 20 ? n * n % 6 : 11'h400;  // 20 intersections of the tiles 0, 1, 3 and 4, then the end of the frame
  tiny_tile_merge_unit unit (.clk(clk), .rst(rst), .hits__payload(hit), .hits__valid(n <= 20), .hits__ready(ready),
    .groups__payload(group), .groups__valid(valid), .groups__ready(1'b1), .tiles_x(11'd3), .tile_count(11'd6),
    .beta(24'd12), .auto(1'b0), .beta_used(), .saturated(), .outside(), .busy());
  always @(posedge clk) if (!rst && ready && n <= 20) n <= n + 1;
  always @(posedge clk) if (valid) $display("tile %0d: %0d intersections, group %0d", group[9:0], group[33:10], group[43:34]);
endmodule
