"""A datapath that serves two users, whose slots pass through it with the number of their user."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, ShapeLike, Signal, Value
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.dataflow import Dataflow, Node
from rtl.culling.datapath import Elaboration, setting_members
from rtl.culling.schedule import Schedule, schedule

USERS = 2


class DatapathSide:
    """A user's side of a shared datapath. It has the streams and settings of a `Datapath` and takes its place in a unit, which
    drives it from outside.

    Attributes:
        sink, source: the streams.
        schedule: start times, instances and registers.
        setting_names: names of the settings, each of which is an attribute, too.
    """

    def __init__(self, port: wiring.PureInterface, plan: Schedule, setting_names: tuple[str, ...]) -> None:
        self.sink: stream.Interface = port.sink
        self.source: stream.Interface = port.source
        self.schedule, self.setting_names = plan, setting_names
        for name in setting_names:
            setattr(self, name, getattr(port, name))


class SharedDatapath(wiring.Component):
    """`Datapath` for two users, which have settings of their own.

    Every slot carries the number of its user, by which each operation chooses its settings and each output its queue. The users
    have output queues of their own, with as many rows as slots fit into the datapath, so that a user that does not take its
    outputs never keeps the other one waiting.

    Parameters:
        graph, interval, carried: as those of `Datapath`.

    Ports:
        users: for each user a `sink`, a `source` and the graph's settings, as those of `Datapath`.

    Attributes:
        sides: the users' sides.

    Throughput: one slot every `interval` cycles, of either user. Where both have one, they take turns: in every other round one
    of them goes first. Latency: that of `Datapath`. With an interval of 1::

        cycle                0     1     2     3     4
        turn              _______~~~~~~______~~~~~~______     user 0 goes first where it is high
        users[0].sink     < A               >< B         >
        users[0].ready    _______~~~~~~______~~~~~~______
        users[1].sink     < C  >< D         >      < E   >
        users[1].ready    ~~~~~~~______~~~~~~______~~~~~~
    """

    def __init__(self, graph: Dataflow, *, interval: int, carried: ShapeLike | None = None) -> None:
        if not isinstance(graph, Dataflow):
            raise TypeError(f"graph must be a Dataflow, not {graph!r}")
        self.schedule = schedule(graph, interval)
        self._graph, self._interval, self._carried = graph, interval, carried
        user = wiring.Signature({
            "sink": Out(stream.Signature(graph.input_layout(carried))),
            "source": In(stream.Signature(graph.output_layout(carried))),
            **{name: Out(member.shape) for name, member in setting_members(graph).items()}})
        super().__init__({"users": In(user).array(USERS)})
        self.sides = tuple(DatapathSide(port, self.schedule, tuple(graph.ports)) for port in self.users)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        work = _SharedElaboration(m, platform, self, self.schedule)
        work.control()
        work.operators()
        work.registers()
        work.queue()
        return m


class _SharedElaboration(Elaboration):
    """The hardware of one shared datapath under construction."""

    def control(self) -> None:
        """The phase, the shift registers of slots that hold data and of their users, and the entry of slots."""
        m, users, rows = self.m, self.unit.users, self.plan.depth
        self.turns()
        turn = Signal()
        with m.If(self.phase[0]):
            m.d.sync += turn.eq(~turn)
        self.frees = [Signal(range(rows + 1), init=rows, name=f"free_{i}") for i in range(USERS)]
        self.enters = [Signal(name=f"enter_{i}") for i in range(USERS)]
        self.enter, self.user, self.entering = Signal(), Signal(), Signal(users[0].sink.payload.shape(), name="entering")
        wants = Signal(USERS)
        firsts = (turn | ~wants[1], ~turn | ~wants[0])
        for i, (user, first) in enumerate(zip(users, firsts, strict=True)):
            m.d.comb += [
                wants[i].eq(user.sink.valid & (self.frees[i] != 0)),
                user.sink.ready.eq(self.phase[0] & (self.frees[i] != 0) & first),
                self.enters[i].eq(user.sink.valid & user.sink.ready)]
        m.d.comb += [
            self.enter.eq(self.enters[0] | self.enters[1]), self.user.eq(wants[1] & firsts[1]),
            self.entering.eq(Mux(self.user, users[1].sink.payload, users[0].sink.payload))]
        self.follow()
        self.users = Signal(len(self.active))
        with m.If(self.phase[0]):
            m.d.sync += self.users.eq(Cat(self.user, self.users)[: len(self.users)])

    def user_of(self, cycle: int) -> Value:
        """The user of the slot that entered `cycle` cycles ago."""
        return self.users[self.era_of(cycle) - 1] if cycle else self.user

    def era_of(self, cycle: int) -> int:
        """How many rounds have begun in so many cycles since a slot entered."""
        return -(-cycle // self.interval)

    def era(self, node: Node, cycle: int) -> int:
        return self.era_of(cycle) if node.stored.kind == "setting" else 0

    def setting(self, node: Node, cycle: int) -> Value:
        first, second = (self.port(node, user) for user in self.unit.users)
        return Mux(self.user_of(cycle), second, first)

    def queue(self) -> None:
        """An output queue for each user."""
        for i, user in enumerate(self.unit.users):
            def now(cycle: int, i: int = i) -> Value:
                return self.now(cycle) & (self.user_of(cycle) == i)

            self.output(user.source, self.frees[i], self.enters[i], now, f"of_{i}_")
