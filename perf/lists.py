"""The tile merge unit's sweep, the header maker and the list reader, stepped cycle by cycle (rtl/sort_tmu/,
rtl/tile_lists/)."""

from __future__ import annotations

from perf import bus
from perf.bus import ENTRIES, TILES
from perf.kernel import step
from perf.layout import Layout
from perf.watch import BLOCKED_LIST, BUSY_LIST
from perf.watch import layout as before
from spec.memory import BEAT_ENTRIES, FIRST_PAGE_ENTRIES, WORDS
from spec.queues import HEADERS, LIST_BEATS, LIST_POINTERS, LIST_TILES

layout = Layout(before.size)
(TILE_COUNT, SWEEP_FROM, SWEPT, LIST_TAKEN, HEAD_TAKEN, HELD, HELD_TILE, HELD_LAST, ASK, ASK_SECOND, POINTER_ROOM, OFFERED,
 WALK, TURNS, LEFT, IN_PAGE, PAGE, PIPE, REQUESTS, R_IN, R_OUT, MORE, SHOWN, SLOTS_MORE, SLOTS) = layout.words(
    "tile_count sweep_from swept list_taken head_taken held held_tile held_last ask ask_second pointer_room offered "
    "walk turns left in_page page pipe requests r_in r_out more shown slots_more slots")
(QUEUE_IN, QUEUE_OUT, POINTER_IN, POINTER_OUT, FLIGHT_IN, FLIGHT_OUT, ENTRIES_BASE, DIRECTORY_BASE, TABLE_BASE) = layout.words(
    "queue_in queue_out pointer_in pointer_out flight_in flight_out entries_base directory_base table_base")
(WAIT_ROOM, WAIT_IN, WAIT_OUT, OWED, TABLE_ASKED, SETTING, SETTING_LEFT, HEADS_IN, HEADS_OUT, LEVELS, RENDERED) = layout.words(
    "wait_room wait_in wait_out owed table_asked setting setting_left heads_in heads_out levels rendered")
(WALK_TILE, WALK_BEAT, POINTER_AT) = layout.words("walk_tile walk_beat pointer_at")
QUEUE, QUEUE_TILE = layout.ring(LIST_TILES), layout.ring(LIST_TILES)
POINTERS, FLIGHT, FLIGHT_KIND = layout.ring(LIST_POINTERS), layout.ring(LIST_BEATS), layout.ring(LIST_BEATS)
ADDRESSES = layout.ring(16)
_WAITING = 2048
WAITING, HEADS = layout.ring(_WAITING), layout.ring(2 * HEADERS)

_DIRECTORY = 16  # added to the kind of a directory beat in flight; the lower bits are its entries or pointers, less one


@step
def step_headers(s, t, granted, head_before, levels_before, rendered):
    """Steps HeaderMaker, which sends a tile and its setting to the array's headers and to the splat fetch."""
    at = s[WAIT_OUT]
    tiles = s[TILE_COUNT]
    moves = (s[SETTING] and at != s[WAIT_IN] and s[WAITING + (at & _WAITING - 1)] <= t
             and s[HEADS_IN] - s[HEADS_OUT] < HEADERS and levels_before < 2)
    uses_up = s[SETTING_LEFT] == 0 or at == tiles - 1
    if moves:
        if rendered[at]:
            s[HEADS + (s[HEADS_IN] & 2 * HEADERS - 1)] = t + 2
            s[HEADS_IN] += 1
            s[LEVELS] += 1
        s[WAIT_OUT] = at + 1
    if (s[SETTING] == 0 or (moves and uses_up)) and bus.offered(s, TILES, t):
        bus.take(s, TILES)
        s[SETTING], s[SETTING_LEFT] = 1, 3
    elif moves:
        s[SETTING] = not uses_up
        s[SETTING_LEFT] -= 1
    if granted:
        bus.read(s, TILES, s[TABLE_BASE] + s[TABLE_ASKED])
        s[TABLE_ASKED] += 1
        s[OWED] -= 1
    if head_before and s[WAIT_IN] - at < s[WAIT_ROOM]:
        tile = s[HEAD_TAKEN]
        s[WAITING + (s[WAIT_IN] & _WAITING - 1)] = t + 2
        s[WAIT_IN] += 1
        s[OWED] += tile & 3 == 0
        s[HEAD_TAKEN] = tile + 1


@step
def step_unpack(s, t, sorter_ready):
    """Moves beats of entries and of pointers into their registers. Returns whether an entry moves on to the sorter."""
    gives = s[SHOWN] and sorter_ready
    ends = gives and s[MORE] == 0
    pointer_moves = s[SLOTS] and s[POINTER_IN] - s[POINTER_OUT] < LIST_POINTERS
    slots_end = pointer_moves and s[SLOTS_MORE] == 0
    at = s[FLIGHT_OUT]
    known = at != s[FLIGHT_IN] and s[FLIGHT + (at & LIST_BEATS - 1)] <= t
    kind = s[FLIGHT_KIND + (at & LIST_BEATS - 1)]
    directory = kind >= _DIRECTORY
    taken = False
    if bus.offered(s, ENTRIES, t):
        taken = known and ((s[SLOTS] == 0 or slots_end) if directory else (s[SHOWN] == 0 or ends))
        if taken:
            bus.take(s, ENTRIES)
            s[BUSY_LIST] += 1
            s[FLIGHT_OUT] = at + 1
        else:
            s[BLOCKED_LIST] += 1
    if taken and not directory:
        s[SHOWN], s[MORE] = 1, kind
    elif gives:
        s[SHOWN] = not ends
        s[MORE] -= 1
    if pointer_moves:
        s[POINTERS + (s[POINTER_IN] & LIST_POINTERS - 1)] = t + 2
        s[POINTER_IN] += 1
    if taken and directory:
        s[SLOTS], s[SLOTS_MORE] = 1, kind - _DIRECTORY
    elif pointer_moves:
        s[SLOTS] = not slots_end
        s[SLOTS_MORE] -= 1
    return gives


@step
def _want(s, t, sends, directory, more, address):
    """Moves a requested beat into the pipeline to memory, when that advances."""
    pipe = s[PIPE]
    s[REQUESTS] += pipe >> 1
    s[PIPE] = (pipe << 1 | sends) & 3
    if sends:
        at = s[FLIGHT_IN]
        s[FLIGHT + (at & LIST_BEATS - 1)] = t + 2
        s[FLIGHT_KIND + (at & LIST_BEATS - 1)] = more + _DIRECTORY * directory
        s[FLIGHT_IN] = at + 1
        s[ADDRESSES + (s[R_IN] & 15)] = address
        s[R_IN] += 1


@step
def step_walk(s, t, granted, list_before, counts, lasts, page_beat, page_start):
    """Finds the beats in which the tiles' lists lie. `granted` says that the oldest request leaves for memory."""
    room = s[REQUESTS] < 2
    if granted:
        bus.read(s, ENTRIES, s[ADDRESSES + (s[R_OUT] & 15)])
        s[R_OUT] += 1
        s[REQUESTS] -= 1
    accepts = room and s[FLIGHT_IN] - s[FLIGHT_OUT] < LIST_BEATS
    asking = s[ASK]
    queue_room = s[QUEUE_IN] - s[QUEUE_OUT] < LIST_TILES
    tile = asking - 1
    pointers = 0
    if asking:
        place = counts[tile] + FIRST_PAGE_ENTRIES - 1
        while place >= 2 * FIRST_PAGE_ENTRIES << pointers:
            pointers += 1
    walks = s[WALK] and s[TURNS] == 0
    second = s[ASK_SECOND]
    asks = asking and pointers and queue_room and s[POINTER_ROOM] >= WORDS and s[OFFERED] == 0
    asked = asks and accepts
    part = (pointers - WORDS if second else min(pointers, WORDS)) if asks else 0
    leaves = asking and queue_room and (pointers == 0 or (asked and (second or pointers <= WORDS)))
    moves = walks and not asks and accepts
    s[OFFERED] = walks and not asks and not accepts
    ends = s[LEFT] <= BEAT_ENTRIES
    more = (s[LEFT] if ends else BEAT_ENTRIES) - 1
    if room:
        _want(s, t, asked or moves, asked, part - 1 if asked else more,
              s[DIRECTORY_BASE] + 2 * tile + second if asked else s[ENTRIES_BASE] + s[WALK_BEAT])
    if asked:
        s[POINTER_ROOM] -= part
        s[ASK_SECOND] = not leaves
    _walk(s, t, moves, ends, counts, page_beat, page_start)
    if leaves:
        s[QUEUE + (s[QUEUE_IN] & LIST_TILES - 1)], s[QUEUE_TILE + (s[QUEUE_IN] & LIST_TILES - 1)] = t + 2, tile
        s[QUEUE_IN] += 1
        s[ASK] = 0
    _listed(s, list_before, s[ASK] == 0, counts, lasts)


@step
def _walk(s, t, moves, ends, counts, page_beat, page_start):
    at = s[QUEUE_OUT]
    loads = (at != s[QUEUE_IN] and s[QUEUE + (at & LIST_TILES - 1)] <= t) and (s[WALK] == 0 or (moves and ends))
    turns = s[TURNS]
    if moves:
        s[WALK_BEAT] += 1
        s[LEFT] -= BEAT_ENTRIES
        s[WALK] = not ends
        s[TURNS] = not ends and s[IN_PAGE] == 1
        s[IN_PAGE] -= 1
    if turns:
        p = s[POINTER_OUT]
        if p != s[POINTER_IN] and s[POINTERS + (p & LIST_POINTERS - 1)] <= t:
            s[POINTER_OUT] = p + 1
            s[POINTER_ROOM] += 1
            s[PAGE] <<= 1
            s[IN_PAGE] = s[PAGE] * (FIRST_PAGE_ENTRIES // BEAT_ENTRIES)
            s[WALK_BEAT] = page_beat[s[POINTER_AT]]
            s[POINTER_AT] += 1
            s[TURNS] = 0
    if loads:
        tile = s[QUEUE_TILE + (at & LIST_TILES - 1)]
        s[QUEUE_OUT] = at + 1
        s[WALK], s[LEFT], s[PAGE] = 1, counts[tile], 1
        s[IN_PAGE] = FIRST_PAGE_ENTRIES // BEAT_ENTRIES
        s[WALK_BEAT] = tile * (FIRST_PAGE_ENTRIES // BEAT_ENTRIES)
        s[POINTER_AT] = page_start[tile]


@step
def _listed(s, list_before, ask_free, counts, lasts):
    """Steps ListedTiles, which holds a tile with entries until it is known whether its group goes on."""
    tile = s[LIST_TAKEN]
    valid = list_before != 0
    filled = valid and counts[tile] != 0
    shows = s[HELD] and (s[HELD_LAST] or filled)
    gives = shows and ask_free
    if gives:
        s[ASK], s[ASK_SECOND] = s[HELD_TILE] + 1, 0
    if valid and (not filled or s[HELD] == 0 or ask_free):
        if filled:
            s[HELD], s[HELD_TILE], s[HELD_LAST] = 1, tile, lasts[tile]
        elif gives:
            s[HELD] = 0
        elif lasts[tile]:
            s[HELD_LAST] = 1
        s[LIST_TAKEN] = tile + 1
    elif gives:
        s[HELD] = 0


@step
def step_sweep(s, t, list_before, head_before):
    """Gives the tile merge unit's next tile to both of its consumers when both have free space."""
    if s[SWEPT] < s[TILE_COUNT] and t >= s[SWEEP_FROM] + s[SWEPT] and list_before < 2 and head_before < 2:
        s[SWEPT] += 1
