// When four channels of LPDDR3 serve requests: windows, banks, open rows, turnarounds and refresh. perf/dram.py describes the
// same controller for the cycle model, and spec/lpddr3.py has the values.
//
// The module has no clock and no contents. memory.sv calls its tasks at every clock edge, in one process and in this order:
// `pass` a clock period, `enter` what arrives, `look` for commands, copy the beats of `sampled`, `leave` what is answered, and
// `settle`. So nothing depends on the order in which a simulator runs processes. Times are picoseconds since the reset.
//
// The requests of a client keep their order, and so do their answers; a request is known by its kind, its client and the place
// of its number. A write leaves its place in the controller when its data are in the device, and is answered after the older
// writes of its client. Nothing differs from the model.
module lpddr3 #(parameter ID_BITS = 1, parameter QUEUE_LOG2 = 8);
  localparam CHANNELS = 4, BANKS = 8, CLIENTS = 1 << ID_BITS, ROW_BITS = 15;
  localparam HELD = 1 << QUEUE_LOG2, NUMBERS = 2 * HELD;  // requests of a kind in the controller; a client's without an answer
  localparam bit READ = 0, WRITE = 1;
  localparam longint NEVER = 64'sh0fff_ffff_ffff_ffff;

  typedef bit [ID_BITS-1:0] client_t;
  typedef bit [QUEUE_LOG2:0] number_t;
  typedef struct packed {client_t client; number_t number;} slot_t;
  typedef struct packed {bit [ROW_BITS-1:0] row; bit [2:0] bank; slot_t slot;} request_t;

  longint tCK, tBURST, tRL, tWL, tDQSCK, tRCD, tRP, tRPab, tRAS, tRRD, tFAW, tWR, tWTR, tRTP, tREFI, tRFC, tCONTROLLER;
  int window, high, low;

  task given(input string name, output longint value);
    if (!$value$plusargs({"lpddr3_", name, "=%d"}, value)) $fatal(1, "give a time of LPDDR3 as +lpddr3_%0s=PICOSECONDS", name);
  endtask
  initial begin
    given("clock", tCK); given("burst", tBURST); given("read_latency", tRL); given("write_latency", tWL);
    given("dqsck", tDQSCK); given("rcd", tRCD); given("rp", tRP); given("rp_all", tRPab); given("ras", tRAS);
    given("rrd", tRRD); given("faw", tFAW); given("wr", tWR); given("wtr", tWTR); given("rtp", tRTP);
    given("refi", tREFI); given("rfc", tRFC); given("controller", tCONTROLLER);
    if (!$value$plusargs("lpddr3_window=%d", window) || !$value$plusargs("lpddr3_high=%d", high)
        || !$value$plusargs("lpddr3_low=%d", low))
      $fatal(1, "give +lpddr3_window=, +lpddr3_high= and +lpddr3_low=, each a number of requests");
  end

  // What a request carries, and when it is done, by kind and slot.
  bit [31:0] address [2][CLIENTS * NUMBERS];
  bit [255:0] data [2][CLIENTS * NUMBERS];
  bit [31:0] strobe [2][CLIENTS * NUMBERS];
  longint done [2][CLIENTS * NUMBERS];
  number_t arrived [2][CLIENTS], answered [2][CLIENTS];
  int held [2];

  // When the writes whose commands were given are done, in the order of the commands.
  longint ends [HELD];
  bit [QUEUE_LOG2-1:0] ends_in, ends_out;

  // Reads whose command was given in this cycle: they see what memory contains now.
  int samples;
  slot_t sampled [HELD];

  // The queues of each channel, the oldest request first, and the state of channels and banks.
  request_t queue [2][CHANNELS][HELD];
  int waiting [2][CHANNELS];
  bit drains [CHANNELS];
  longint next_look [CHANNELS], next_refresh [CHANNELS], column_ok [2][CHANNELS], activated [CHANNELS][4];
  bit is_open [CHANNELS][BANKS];
  bit [ROW_BITS-1:0] open_row [CHANNELS][BANKS];
  longint column_after [CHANNELS][BANKS], precharge_after [CHANNELS][BANKS], activate_after [CHANNELS][BANKS];

  longint now = 0;
  bit [31:0] activates = 0, refreshes = 0;
  client_t turn [2];

  function automatic longint latest(longint a, longint b); return a > b ? a : b; endfunction

  task automatic restart;
    now = 0; activates = 0; refreshes = 0; samples = 0;
    for (int kind = 0; kind < 2; kind++) begin
      held[kind] = 0; turn[kind] = 0; ends_in = 0; ends_out = 0;
      for (int i = 0; i < CLIENTS; i++) begin arrived[kind][i] = 0; answered[kind][i] = 0; end
      for (int c = 0; c < CHANNELS; c++) begin waiting[kind][c] = 0; column_ok[kind][c] = 0; end
    end
    for (int c = 0; c < CHANNELS; c++) begin
      drains[c] = 0; next_look[c] = 0; next_refresh[c] = tREFI * (c + 1) / CHANNELS;  // one channel after the other
      for (int i = 0; i < 4; i++) activated[c][i] = -NEVER;
      for (int b = 0; b < BANKS; b++) begin
        is_open[c][b] = 0; column_after[c][b] = 0; precharge_after[c][b] = 0; activate_after[c][b] = 0;
      end
    end
  endtask

  // Lets a clock period pass. Where it is longer than the device's, channels look for commands inside it as well.
  task automatic pass(input longint period);
    longint begins = now, looks = (period + tCK - 1) / tCK;
    samples = 0;
    for (longint i = 1; i < looks; i++) begin
      now = begins + period * i / looks;
      look;
    end
    now = begins + period;
  endtask

  task automatic enter(input bit kind, input client_t client, input [31:0] at, input [255:0] beat, input [31:0] enables);
    bit [26:0] place = at[31:5];
    int c = {30'b0, place[1:0] ^ place[3:2] ^ place[5:4] ^ place[7:6] ^ place[9:8] ^ place[11:10]};
    slot_t slot = '{client: client, number: arrived[kind][client]};
    address[kind][slot] = at; data[kind][slot] = beat; strobe[kind][slot] = enables; done[kind][slot] = NEVER;
    arrived[kind][client]++;
    held[kind]++;
    queue[kind][c][waiting[kind][c]] = '{row: place[26:12], bank: place[11:9] ^ place[14:12], slot: slot};
    waiting[kind][c]++;
    if (next_look[c] > now) next_look[c] = now;
  endtask

  // Gives each channel's next command where one may be given now.
  task automatic look;
    for (int c = 0; c < CHANNELS; c++)
      if (now >= next_look[c]) begin
        if (now >= next_refresh[c]) refresh(c);
        else command(c);
      end
  endtask

  task automatic refresh(input int c);
    longint ready = now;
    for (int b = 0; b < BANKS; b++) begin
      if (is_open[c][b]) ready = latest(ready, precharge_after[c][b]);
      is_open[c][b] = 0;
    end
    next_look[c] = ready + tRPab + tRFC;
    for (int b = 0; b < BANKS; b++) activate_after[c][b] = latest(activate_after[c][b], next_look[c]);
    next_refresh[c] += tREFI;
    refreshes++;
  endtask

  task automatic command(input int c);
    int reads = waiting[READ][c], writes = waiting[WRITE][c], place;
    bit kind;
    request_t request;
    drains[c] = writes >= (drains[c] ? low + 1 : high) || (reads == 0 && writes != 0);
    kind = drains[c];
    place = chosen(c, kind);
    if (place < 0) return;
    request = queue[kind][c][place];
    if (!is_open[c][request.bank]) begin
      is_open[c][request.bank] = 1;
      open_row[c][request.bank] = request.row;
      column_after[c][request.bank] = now + tRCD;
      precharge_after[c][request.bank] = now + tRAS;
      for (int i = 3; i > 0; i--) activated[c][i] = activated[c][i-1];
      activated[c][0] = now;
      activates++;
    end else if (open_row[c][request.bank] != request.row) begin
      is_open[c][request.bank] = 0;
      activate_after[c][request.bank] = now + tRP;
    end else begin
      transfer(c, kind, request);
      waiting[kind][c]--;
      for (int i = place; i < waiting[kind][c]; i++) queue[kind][c][i] = queue[kind][c][i+1];
    end
    next_look[c] = now + tCK;
  endtask

  // The place of the request whose next command may be given now, or -1. Open rows go first, then the oldest request; a row
  // that another request of the window needs stays open.
  function automatic int chosen(input int c, input bit kind);
    int count = waiting[kind][c] < window ? waiting[kind][c] : window;
    bit [BANKS-1:0] wanted = 0;
    for (int i = 0; i < count; i++) begin
      request_t request = queue[kind][c][i];
      if (is_open[c][request.bank] && open_row[c][request.bank] == request.row) begin
        wanted[request.bank] = 1;
        if (latest(column_after[c][request.bank], column_ok[kind][c]) <= now) return i;
      end
    end
    for (int i = 0; i < count; i++) begin
      bit [2:0] bank = queue[kind][c][i].bank;
      if (!wanted[bank]) begin
        wanted[bank] = 1;
        if (is_open[c][bank] ? precharge_after[c][bank] <= now
            : activate_after[c][bank] <= now && activated[c][0] + tRRD <= now && activated[c][3] + tFAW <= now) return i;
      end
    end
    return -1;
  endfunction

  // A READ or WRITE command: when its data are through, and what must wait for it.
  task automatic transfer(input int c, input bit kind, input request_t request);
    longint end_of_data = kind ? now + tWL + tCK + tBURST : now + tRL + tDQSCK + tBURST;
    column_ok[kind][c] = now + tBURST;
    if (kind) begin
      column_ok[READ][c] = latest(column_ok[READ][c], end_of_data + tWTR);
      precharge_after[c][request.bank] = latest(precharge_after[c][request.bank], end_of_data + tWR);
      ends[ends_in] = end_of_data + tCONTROLLER;
      ends_in++;
    end else begin
      column_ok[WRITE][c] = latest(column_ok[WRITE][c], end_of_data + tCK - tWL);
      precharge_after[c][request.bank] = latest(precharge_after[c][request.bank], now + tRTP);
      sampled[samples] = request.slot;
      samples++;
    end
    done[kind][request.slot] = end_of_data + tCONTROLLER;
  endtask

  // Whether no further request of a kind may be accepted, where `more` wait to enter.
  function automatic bit is_full(input bit kind, input int more);
    for (int i = 0; i < CLIENTS; i++) begin
      number_t unanswered = arrived[kind][i] - answered[kind][i];
      if (unanswered + more >= NUMBERS - 2) return 1;
    end
    return held[kind] + more >= HELD;
  endfunction

  // Frees the places of writes whose data are in the device.
  task automatic settle;
    while (held[WRITE] != 0 && ends_out != ends_in && ends[ends_out] < now) begin
      ends_out++;
      held[WRITE]--;
    end
  endtask

  function automatic bit is_busy;
    for (int c = 0; c < CHANNELS; c++) if (waiting[READ][c] != 0 || waiting[WRITE][c] != 0) return 1;
    return 0;
  endfunction

  // Whether the oldest request of some client is done; `leave` then removes it. Clients have their turns.
  function automatic bit is_due(input bit kind);
    return next_client(kind) >= 0;
  endfunction

  function automatic int next_client(input bit kind);
    for (int i = 1; i <= CLIENTS; i++) begin
      client_t client = turn[kind] + client_t'(i);
      if (arrived[kind][client] != answered[kind][client] && done[kind][oldest(kind, client)] < now) return {1'b0, client};
    end
    return -1;
  endfunction

  function automatic slot_t oldest(input bit kind, input client_t client);
    return '{client: client, number: answered[kind][client]};
  endfunction

  task automatic leave(input bit kind, output slot_t slot);
    turn[kind] = client_t'(next_client(kind));
    slot = oldest(kind, turn[kind]);
    answered[kind][turn[kind]]++;
    if (kind == READ) held[kind]--;
  endtask
endmodule
