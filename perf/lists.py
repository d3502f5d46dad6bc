"""The tile merge unit's sweep, the header maker and the list reader, stepped cycle by cycle (rtl/sort_tmu/,
rtl/tile_lists/)."""

from __future__ import annotations

from perf import bus
from perf.bus import ENTRIES, TILES
from perf.kernel import step
from perf.layout import Layout
from perf.watch import layout as before
from spec.memory import BEAT_ENTRIES, FIRST_PAGE_BEATS, FIRST_PAGE_ENTRIES, WORDS
from spec.queues import HEADERS, LIST_BEATS, LIST_POINTERS, LIST_TILES

layout = Layout(before)
layout.words("""
    tile_count sweep_from swept list_taken head_taken held held_tile held_last ask ask_second pointer_room walk_offered
    walk turns walk_left in_page page walk_beat pointer_at list_pipe list_requests request_in request_out entry_more entry_shown
    slots_more slots tiles_in tiles_out pointer_in pointer_out flight_in flight_out entries_base directory_base table_base
    wait_room wait_in wait_out owed table_asked setting setting_left heads_in heads_out fetch_tiles""")
_WAITING = 2048
layout.ring("tile_times", LIST_TILES)
layout.ring("tile_queue", LIST_TILES)
layout.ring("pointer_times", LIST_POINTERS)
layout.ring("flight_times", LIST_BEATS)
layout.ring("flight_kind", LIST_BEATS)
layout.ring("request_address", 16)
layout.ring("head_waits", _WAITING)
layout.ring("heads", 2 * HEADERS)

_DIRECTORY = 16  # added to the kind of a directory beat in flight; the lower bits are its entries or pointers, less one


@step
def step_headers(s, t, granted, head_before, levels_before, rendered):
    """Steps HeaderMaker, which sends a tile and its setting to the array's headers and to the splat fetch."""
    at = s.wait_out
    tiles = s.tile_count
    moves = (s.setting and at != s.wait_in and s.head_waits[at & _WAITING - 1] <= t
             and s.heads_in - s.heads_out < HEADERS and levels_before < 2)
    uses_up = s.setting_left == 0 or at == tiles - 1
    if moves:
        if rendered[at]:
            s.heads[s.heads_in & 2 * HEADERS - 1] = t + 2
            s.heads_in += 1
            s.fetch_tiles += 1
        s.wait_out = at + 1
    if (s.setting == 0 or (moves and uses_up)) and bus.offered(s, TILES, t):
        bus.take(s, TILES)
        s.setting, s.setting_left = 1, 3
    elif moves:
        s.setting = not uses_up
        s.setting_left -= 1
    if granted:
        bus.read(s, TILES, s.table_base + s.table_asked)
        s.table_asked += 1
        s.owed -= 1
    if head_before and s.wait_in - at < s.wait_room:
        tile = s.head_taken
        s.head_waits[s.wait_in & _WAITING - 1] = t + 2
        s.wait_in += 1
        s.owed += tile & 3 == 0
        s.head_taken = tile + 1


@step
def step_unpack(s, t, sorter_ready):
    """Moves beats of entries and of pointers into their registers. Returns whether an entry moves on to the sorter."""
    gives = s.entry_shown and sorter_ready
    ends = gives and s.entry_more == 0
    pointer_moves = s.slots and s.pointer_in - s.pointer_out < LIST_POINTERS
    slots_end = pointer_moves and s.slots_more == 0
    at = s.flight_out
    known = at != s.flight_in and s.flight_times[at & LIST_BEATS - 1] <= t
    kind = s.flight_kind[at & LIST_BEATS - 1]
    directory = kind >= _DIRECTORY
    taken = False
    if bus.offered(s, ENTRIES, t):
        taken = known and ((s.slots == 0 or slots_end) if directory else (s.entry_shown == 0 or ends))
        if taken:
            bus.take(s, ENTRIES)
            s.busy_list_read += 1
            s.flight_out = at + 1
        else:
            s.blocked_list_read += 1
    if taken and not directory:
        s.entry_shown, s.entry_more = 1, kind
    elif gives:
        s.entry_shown = not ends
        s.entry_more -= 1
    if pointer_moves:
        s.pointer_times[s.pointer_in & LIST_POINTERS - 1] = t + 2
        s.pointer_in += 1
    if taken and directory:
        s.slots, s.slots_more = 1, kind - _DIRECTORY
    elif pointer_moves:
        s.slots = not slots_end
        s.slots_more -= 1
    return gives


@step
def _want(s, t, sends, directory, more, address):
    """Moves a requested beat into the pipeline to memory, when that advances."""
    pipe = s.list_pipe
    s.list_requests += pipe >> 1
    s.list_pipe = (pipe << 1 | sends) & 3
    if sends:
        at = s.flight_in
        s.flight_times[at & LIST_BEATS - 1] = t + 2
        s.flight_kind[at & LIST_BEATS - 1] = more + _DIRECTORY * directory
        s.flight_in = at + 1
        s.request_address[s.request_in & 15] = address
        s.request_in += 1


@step
def step_walk(s, t, granted, list_before, counts, lasts, page_beat, page_start):
    """Finds the beats in which the tiles' lists lie. `granted` says that the oldest request leaves for memory."""
    room = s.list_requests < 2
    if granted:
        bus.read(s, ENTRIES, s.request_address[s.request_out & 15])
        s.request_out += 1
        s.list_requests -= 1
    accepts = room and s.flight_in - s.flight_out < LIST_BEATS
    asking = s.ask
    queue_room = s.tiles_in - s.tiles_out < LIST_TILES
    tile = asking - 1
    pointers = 0
    if asking:
        place = counts[tile] + FIRST_PAGE_ENTRIES - 1
        while place >= 2 * FIRST_PAGE_ENTRIES << pointers:
            pointers += 1
    walks = s.walk and s.turns == 0
    second = s.ask_second
    asks = asking and pointers and queue_room and s.pointer_room >= WORDS and s.walk_offered == 0
    asked = asks and accepts
    part = (pointers - WORDS if second else min(pointers, WORDS)) if asks else 0
    leaves = asking and queue_room and (pointers == 0 or (asked and (second or pointers <= WORDS)))
    moves = walks and not asks and accepts
    s.walk_offered = walks and not asks and not accepts
    ends = s.walk_left <= BEAT_ENTRIES
    more = (s.walk_left if ends else BEAT_ENTRIES) - 1
    if room:
        _want(s, t, asked or moves, asked, part - 1 if asked else more,
              s.directory_base + 2 * tile + second if asked else s.entries_base + s.walk_beat)
    if asked:
        s.pointer_room -= part
        s.ask_second = not leaves
    _walk(s, t, moves, ends, counts, page_beat, page_start)
    if leaves:
        s.tile_times[s.tiles_in & LIST_TILES - 1], s.tile_queue[s.tiles_in & LIST_TILES - 1] = t + 2, tile
        s.tiles_in += 1
        s.ask = 0
    _listed(s, list_before, s.ask == 0, counts, lasts)


@step
def _walk(s, t, moves, ends, counts, page_beat, page_start):
    at = s.tiles_out
    loads = (at != s.tiles_in and s.tile_times[at & LIST_TILES - 1] <= t) and (s.walk == 0 or (moves and ends))
    turns = s.turns
    if moves:
        s.walk_beat += 1
        s.walk_left -= BEAT_ENTRIES
        s.walk = not ends
        s.turns = not ends and s.in_page == 1
        s.in_page -= 1
    if turns:
        p = s.pointer_out
        if p != s.pointer_in and s.pointer_times[p & LIST_POINTERS - 1] <= t:
            s.pointer_out = p + 1
            s.pointer_room += 1
            s.page <<= 1
            s.in_page = s.page * FIRST_PAGE_BEATS
            s.walk_beat = page_beat[s.pointer_at]
            s.pointer_at += 1
            s.turns = 0
    if loads:
        tile = s.tile_queue[at & LIST_TILES - 1]
        s.tiles_out = at + 1
        s.walk, s.walk_left, s.page = 1, counts[tile], 1
        s.in_page = FIRST_PAGE_BEATS
        s.walk_beat = tile * FIRST_PAGE_BEATS
        s.pointer_at = page_start[tile]


@step
def _listed(s, list_before, ask_free, counts, lasts):
    """Steps ListedTiles, which holds a tile with entries until it is known whether its group goes on."""
    tile = s.list_taken
    valid = list_before != 0
    filled = valid and counts[tile] != 0
    shows = s.held and (s.held_last or filled)
    gives = shows and ask_free
    if gives:
        s.ask, s.ask_second = s.held_tile + 1, 0
    if valid and (not filled or s.held == 0 or ask_free):
        if filled:
            s.held, s.held_tile, s.held_last = 1, tile, lasts[tile]
        elif gives:
            s.held = 0
        elif lasts[tile]:
            s.held_last = 1
        s.list_taken = tile + 1
    elif gives:
        s.held = 0


@step
def step_sweep(s, t, list_before, head_before):
    """Gives the tile merge unit's next tile to both of its consumers when both have free space."""
    if s.swept < s.tile_count and t >= s.sweep_from + s.swept and list_before < 2 and head_before < 2:
        s.swept += 1
