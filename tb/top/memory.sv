// A memory with an AXI4 port, of one of two kinds. Every transaction is a single 32-byte beat.
//
// With `lpddr3` high it is four channels of DRAM (lpddr3.sv) beside a machine whose clock period is `clock_ps` picoseconds.
// The answers of a client come in order. A read samples memory when its command is given.
//
// Otherwise the memory is ideal, and answers come in order. A request waits in a queue until it is served. Serving one costs
// `cost` credits, and every cycle brings `gain` credits (with cost 0, one read and one write are served in every cycle). Reads
// and writes are served in the order of their arrival. A read samples memory when it is served, and is answered at the
// earliest `latency` cycles after its request.
//
// In both kinds a write changes memory when it is answered, so that the memory exposes a master that reads before it has this
// answer. Ready and answers pause in random cycles, `pauses` of 256. Contents are loaded from FOLDER/NUMBER.bin when `load`
// rises, and written to FOLDER/NUMBER.dump when `dump` rises.
// Plusargs are +folder=FOLDER, +beats=N, the size of memory in beats, and those of lpddr3.sv; so one build serves scenes of
// every size, and both kinds.
module memory #(parameter ID_BITS = 1, parameter QUEUE_LOG2 = 8) (
  input clk, input rst,
  input lpddr3, input [31:0] clock_ps, input [31:0] latency, input [31:0] gain, input [31:0] cost, input [7:0] pauses,
  input [31:0] first_writable, input [31:0] error_first, input [31:0] error_end, input [31:0] watch_first, input [31:0] watch_end,
  input load, input poison, input dump, input [31:0] file_number, input [31:0] file_first, input [31:0] file_beats,
  output reg [31:0] reads = 0, output reg [31:0] writes = 0, output reg [31:0] busy = 0, output reg [31:0] watched = 0,
  output reg [31:0] activates = 0, output reg [31:0] refreshes = 0, output reg [31:0] idle = 0, output reg [7:0] errors = 0,
  input [ID_BITS-1:0] arid, input [31:0] araddr, input [7:0] arlen, input [2:0] arsize, input [1:0] arburst,
  input arvalid, output reg arready = 0,
  output reg [ID_BITS-1:0] rid, output reg [255:0] rdata, output reg [1:0] rresp, output rlast,
  output reg rvalid = 0, input rready,
  input [ID_BITS-1:0] awid, input [31:0] awaddr, input [7:0] awlen, input [2:0] awsize, input [1:0] awburst,
  input awvalid, output reg awready = 0,
  input [255:0] wdata, input [31:0] wstrb, input wlast, input wvalid, output reg wready = 0,
  output reg [ID_BITS-1:0] bid, output reg [1:0] bresp, output reg bvalid = 0, input bready
);
  localparam QUEUE = 1 << QUEUE_LOG2, TOP = QUEUE_LOG2;
  integer beats;
  bit [255:0] cells [];
  initial begin
    if (!$value$plusargs("beats=%d", beats)) $fatal(1, "give the size of memory as +beats=N");
    cells = new [beats];
  end
  assign rlast = 1;

  // Ring buffers: a request enters at `in`, is served at `turn`, and is answered at `out`.
  reg [ID_BITS-1:0] read_id [0:QUEUE-1], write_id [0:QUEUE-1];
  reg [31:0] read_address [0:QUEUE-1], write_address [0:QUEUE-1];
  reg [31:0] read_due [0:QUEUE-1], write_due [0:QUEUE-1];
  reg [255:0] read_data [0:QUEUE-1], write_data [0:QUEUE-1];
  reg [31:0] write_strobe [0:QUEUE-1];
  reg [TOP:0] read_in = 0, read_turn = 0, read_out = 0;
  reg [TOP:0] write_in = 0, data_in = 0, write_turn = 0, write_out = 0;
  reg [TOP:0] reads_held, writes_held, data_held;
  reg [31:0] now = 0, credit = 0;
  reg [63:0] dice = 64'h9e3779b97f4a7c15;
  reg write_first, wants_read, wants_write, answers;
  reg [ID_BITS+TOP:0] slot;  // of a request in lpddr3.sv: its client and its number
  integer sample;
  reg [31:0] answer_address, answer_strobe;
  reg [255:0] answer_data;
  lpddr3 #(.ID_BITS(ID_BITS), .QUEUE_LOG2(QUEUE_LOG2)) dram ();

  function [255:0] mask(input [31:0] strobe);
    integer i;
    for (i = 0; i < 32; i = i + 1) mask[8 * i +: 8] = {8{strobe[i]}};
  endfunction
  function outside(input [31:0] address); outside = (address >> 5) >= beats; endfunction
  function failing(input [31:0] address);
    failing = outside(address) | (address >= error_first & address < error_end);
  endfunction
  function misshapen(input [31:0] address, input [7:0] len, input [2:0] size);
    misshapen = address[4:0] != 0 | len != 0 | size != 5;
  endfunction

  // Whatever the master offers must stay unchanged until it is accepted.
  reg ar_waits = 0, aw_waits = 0, w_waits = 0;
  reg [ID_BITS+31:0] ar_held, aw_held;
  reg [287:0] w_held;

  always @(posedge clk) begin
    dice = dice ^ (dice << 13);
    dice = dice ^ (dice >> 7);
    dice = dice ^ (dice << 17);
    idle <= (arvalid & arready) | (awvalid & awready) | (wvalid & wready) | (rvalid & rready) | (bvalid & bready) ? 0 : idle + 1;
    if (rst) begin
      read_in = 0; read_turn = 0; read_out = 0;
      write_in = 0; data_in = 0; write_turn = 0; write_out = 0;
      now = 0; credit = 0;
      dram.restart;
      activates <= 0; refreshes <= 0;
      arready <= 0; awready <= 0; wready <= 0; rvalid <= 0; bvalid <= 0;
      reads <= 0; writes <= 0; busy <= 0; watched <= 0; errors <= 0; idle <= 0;
      ar_waits <= 0; aw_waits <= 0; w_waits <= 0;
    end else begin
      errors <= errors
        | (ar_waits & (~arvalid | {arid, araddr} != ar_held) ? 1 : 0)
        | (aw_waits & (~awvalid | {awid, awaddr} != aw_held) ? 1 : 0)
        | (w_waits & (~wvalid | {wdata, wstrb} != w_held) ? 1 : 0)
        | (arvalid & misshapen(araddr, arlen, arsize) ? 2 : 0) | (awvalid & misshapen(awaddr, awlen, awsize) ? 2 : 0)
        | (wvalid & ~wlast ? 2 : 0)
        | ((arvalid & outside(araddr)) | (awvalid & outside(awaddr)) ? 4 : 0)
        | (awvalid & awaddr < first_writable ? 8 : 0);
      ar_waits <= arvalid & ~arready; ar_held <= {arid, araddr};
      aw_waits <= awvalid & ~awready; aw_held <= {awid, awaddr};
      w_waits <= wvalid & ~wready; w_held <= {wdata, wstrb};

      now = now + 1;
      if (lpddr3) dram.pass({32'b0, clock_ps});
      if (arvalid & arready & lpddr3) begin
        dram.enter(0, arid, araddr, 0, 0);
      end else if (arvalid & arready) begin
        read_id[read_in[TOP-1:0]] = arid;
        read_address[read_in[TOP-1:0]] = araddr;
        read_due[read_in[TOP-1:0]] = now + latency - 1;
        read_in = read_in + 1;
      end
      if (awvalid & awready) begin
        write_id[write_in[TOP-1:0]] = awid;
        write_address[write_in[TOP-1:0]] = awaddr;
        write_due[write_in[TOP-1:0]] = now + latency - 1;
        write_in = write_in + 1;
      end
      if (wvalid & wready) begin
        write_data[data_in[TOP-1:0]] = wdata;
        write_strobe[data_in[TOP-1:0]] = wstrb;
        data_in = data_in + 1;
      end

      if (lpddr3) begin
        if (write_turn != write_in & write_turn != data_in) begin
          dram.enter(1, write_id[write_turn[TOP-1:0]], write_address[write_turn[TOP-1:0]], write_data[write_turn[TOP-1:0]],
                     write_strobe[write_turn[TOP-1:0]]);
          write_turn = write_turn + 1;
          write_out = write_turn;
        end
        if (dram.is_busy()) busy <= busy + 1;
        dram.look;
        for (sample = 0; sample < dram.samples; sample = sample + 1) begin
          slot = dram.sampled[sample];
          dram.data[0][slot] = cells[dram.address[0][slot][31:5]];
        end
        reads <= reads + dram.samples;
        activates <= dram.activates;
        refreshes <= dram.refreshes;
      end else begin
        // Serve requests: the older one first, then the other one if there is credit left.
        credit = credit + gain > cost + cost ? cost + cost : credit + gain;
        wants_read = read_turn != read_in;
        wants_write = write_turn != write_in & write_turn != data_in;
        if (wants_read | wants_write) busy <= busy + 1;
        write_first = wants_write & wants_read & $signed(write_due[write_turn[TOP-1:0]] - read_due[read_turn[TOP-1:0]]) < 0;
        if (wants_write & write_first & credit >= cost) begin
          write_turn = write_turn + 1;
          credit = credit - cost;
          wants_write = 0;
        end
        if (wants_read & credit >= cost) begin
          read_data[read_turn[TOP-1:0]] = cells[read_address[read_turn[TOP-1:0]][31:5]];
          read_turn = read_turn + 1;
          credit = credit - cost;
          reads <= reads + 1;
        end
        if (wants_write & credit >= cost) begin
          write_turn = write_turn + 1;
          credit = credit - cost;
        end
      end

      // Answer requests.
      if (~rvalid | rready) begin
        rvalid <= 0;
        answers = lpddr3 ? dram.is_due(0) : read_out != read_turn & $signed(now - read_due[read_out[TOP-1:0]]) >= 0;
        if (answers & (pauses <= dice[7:0])) begin
          if (lpddr3) begin
            dram.leave(0, slot);
            rid <= slot[TOP+1 +: ID_BITS];
            answer_address = dram.address[0][slot];
            answer_data = dram.data[0][slot];
          end else begin
            rid <= read_id[read_out[TOP-1:0]];
            answer_address = read_address[read_out[TOP-1:0]];
            answer_data = read_data[read_out[TOP-1:0]];
            read_out = read_out + 1;
          end
          rvalid <= 1;
          rdata <= failing(answer_address) ? {4{dice}} : answer_data;
          rresp <= failing(answer_address) ? 2 : 0;
        end
      end
      if (~bvalid | bready) begin
        bvalid <= 0;
        answers = lpddr3 ? dram.is_due(1) : write_out != write_turn & $signed(now - write_due[write_out[TOP-1:0]]) >= 0;
        if (answers & (pauses <= dice[15:8])) begin
          if (lpddr3) begin
            dram.leave(1, slot);
            bid <= slot[TOP+1 +: ID_BITS];
            answer_address = dram.address[1][slot];
            answer_data = dram.data[1][slot];
            answer_strobe = dram.strobe[1][slot];
          end else begin
            bid <= write_id[write_out[TOP-1:0]];
            answer_address = write_address[write_out[TOP-1:0]];
            answer_data = write_data[write_out[TOP-1:0]];
            answer_strobe = write_strobe[write_out[TOP-1:0]];
            write_out = write_out + 1;
          end
          bvalid <= 1;
          bresp <= failing(answer_address) ? 2 : 0;
          writes <= writes + 1;
          if (!failing(answer_address))
            cells[answer_address[31:5]] =
              (cells[answer_address[31:5]] & ~mask(answer_strobe)) | (answer_data & mask(answer_strobe));
          if (answer_address >= watch_first & answer_address < watch_end) watched <= watched + $countones(answer_strobe);
        end
      end
      dram.settle;
      reads_held = read_in - read_out;
      writes_held = write_in - write_out;
      data_held = data_in - write_out;
      arready <= ~(lpddr3 ? dram.is_full(0, 0) : reads_held[TOP]) & pauses <= dice[23:16];
      awready <= ~(lpddr3 ? dram.is_full(1, writes_held) : writes_held[TOP]) & pauses <= dice[31:24];
      wready <= ~(lpddr3 ? dram.is_full(1, data_held) : data_held[TOP]) & pauses <= dice[39:32];
    end
  end

  string folder, path;
  reg load_before = 0, dump_before = 0;
  integer file, i, count;
  reg [255:0] beat;
  initial if (!$value$plusargs("folder=%s", folder)) folder = ".";
  always @(posedge clk) begin
    load_before <= load;
    dump_before <= dump;
    if (load & ~load_before) begin
      if (poison) for (i = 0; i < beats; i = i + 1) cells[i] = {8{32'hdeadbeef ^ i}};
      $sformat(path, "%0s/%0d.bin", folder, file_number);
      file = $fopen(path, "rb");
      if (file == 0) $fatal(1, "cannot read %0s", path);
      for (i = file_first; i < file_first + file_beats; i = i + 1) begin
        count = $fread(beat, file);
        if (count != 32) $fatal(1, "%0s ends in beat %0d of %0d", path, i - file_first, file_beats);
        cells[i] = beat;
      end
      $fclose(file);
    end
    if (dump & ~dump_before) begin
      $sformat(path, "%0s/%0d.dump", folder, file_number);
      file = $fopen(path, "wb");
      if (file == 0) $fatal(1, "cannot write %0s", path);
      for (i = file_first; i < file_first + file_beats; i = i + 1) $fwrite(file, "%u", cells[i]);
      $fclose(file);
    end
  end
endmodule
