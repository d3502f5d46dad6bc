"""Makes hardware from a graph: operators, registers and an output queue, arranged by a schedule, between two streams."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from amaranth.hdl import Cat, Const, Module, Mux, ShapeLike, Signal, Value
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Member, Out

from rtl.culling.dataflow import Dataflow, Node, Operator, as_value
from rtl.culling.schedule import Schedule, schedule
from rtl.emit import add_shared
from rtl.float.number import Let
from rtl.float.unit import FloatUnit


def setting_members(graph: Dataflow) -> dict[str, Member]:
    """Ports for the settings of a graph, by name; a setting of several numbers is an array."""
    return {name: In(nodes[0].shape if len(nodes) == 1 else data.ArrayLayout(nodes[0].shape, len(nodes)))
            for name, nodes in graph.ports.items()}


def _make(kind: Operator) -> FloatUnit:
    return kind.make()


class Datapath(wiring.Component):
    """Evaluates the operations of a graph for one slot after another.

    Parameters:
        graph: what is computed.
        interval: least number of cycles between slots. With more than 1, operators are shared by a static schedule, and a slot
            enters only in phase 0, which is one cycle in `interval`.
        carried: shape of data that does not enter the graph but leaves with its slot; None where there is none.

    Ports:
        sink: items with a field for each input of the graph, and `carried`.
        source: items with a field for each output of the graph, and `carried`, in the order of the sink.
        one port for every setting of the graph, with the setting's name; it is an array where the setting has several numbers.
            Settings may change while no slot is inside.

    Attributes:
        schedule: start times, instances and registers.

    Throughput: one slot every `interval` cycles. Latency: schedule.length + 2 cycles from the transfer of a slot at the sink
    until the source offers it. No slot waits on its way: a slot enters only when a row of the output queue is free for it, and
    the queue has as many rows as slots fit between entry and exit at full rate. The cycle in which a value is first available
    is called its birth. Each output is written into its slot's row at its birth, so that early outputs need no registers::

        interval 4       0    1    2    3    4    5    6    7    8
        phase            0    1    2    3    0    1    2    3    0
        sink.ready       ~~~~~_______________~~~~~_______________~~~~~    a row is free
        sink             < A >               < B >
        first registers       <  A                ><  B
    """

    def __init__(self, graph: Dataflow, *, interval: int, carried: ShapeLike | None = None) -> None:
        if not isinstance(graph, Dataflow):
            raise TypeError(f"graph must be a Dataflow, not {graph!r}")
        self.schedule = schedule(graph, interval)
        self._graph, self._interval, self._carried = graph, interval, carried
        super().__init__({
            "sink": In(stream.Signature(graph.input_layout(carried))),
            "source": Out(stream.Signature(graph.output_layout(carried))), **setting_members(graph)})

    @property
    def setting_names(self) -> tuple[str, ...]:
        """The names of the ports that are settings."""
        return tuple(self._graph.ports)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        work = Elaboration(m, platform, self, self.schedule)
        work.control()
        work.operators()
        work.registers()
        work.queue()
        return m


class Elaboration:
    """The hardware of one datapath under construction."""

    def __init__(self, m: Module, platform: object, unit: Datapath, plan: Schedule) -> None:
        self.m, self.platform, self.unit, self.plan = m, platform, unit, plan
        self.interval, self.copies = plan.interval, plan.copies()
        self.origin: dict[Node, Value] = {}
        """The wire of each value in the cycle of its birth."""
        self.chain: dict[Node, list[Value]] = {}
        """The registers that delay each value."""
        for node, count in self.copies.items():
            self.chain[node] = [
                Signal(node.shape, name=f"{node.name}_{i + 1}", reset_less=True) for i in range(count)]

    def control(self) -> None:
        """The phase, the shift register of slots that hold data, and the entry of slots."""
        m, sink, rows = self.m, self.unit.sink, self.plan.depth
        self.entering: data.View = sink.payload
        self.turns()
        self.free = Signal(range(rows + 1), init=rows)
        self.enter = Signal()
        m.d.comb += [sink.ready.eq(self.phase[0] & (self.free != 0)), self.enter.eq(sink.valid & sink.ready)]
        self.follow()

    def turns(self) -> None:
        """The phase: which of `interval` cycles this is."""
        self.phase = Signal(self.interval, init=1)
        if self.interval > 1:
            self.m.d.sync += self.phase.eq(self.phase.rotate_left(1))

    def follow(self) -> None:
        """The shift register of slots that hold data."""
        rounds = -(-self.plan.length // self.interval)
        self.active = Signal(rounds)
        with self.m.If(self.phase[0]):
            self.m.d.sync += self.active.eq(Cat(self.enter, self.active)[:rounds])

    def now(self, cycle: int) -> Value:
        """Whether a slot with data entered `cycle` cycles ago."""
        if cycle == 0:
            return self.enter
        active = self.active[-(-cycle // self.interval) - 1]
        return active & self.phase[cycle % self.interval] if self.interval > 1 else active

    def read(self, node: Node, cycle: int) -> Value:
        """The wire or register that holds a node's value `cycle` cycles after its slot entered."""
        if node.kind == "view":
            return as_value(node.fn(self.read(node.operands[0], cycle)))
        if node.kind == "constant":
            return node.fn()
        if node.kind == "setting":
            return self.setting(node, cycle)
        place = self.plan.place(node, cycle)
        return self.chain[node][place - 1] if place else self.at_birth(node)

    def setting(self, node: Node, cycle: int) -> Value:
        """A setting of the slot that entered `cycle` cycles ago."""
        return self.port(node, self.unit)

    def era(self, node: Node, cycle: int) -> int:
        """Differs where an operation that reads the node in one cycle may not read it in another one: never here."""
        return 0

    def port(self, node: Node, ports: Any) -> Value:
        """The port of a setting among `ports`."""
        for name, nodes in self.unit._graph.ports.items():
            if node in nodes:
                port = getattr(ports, name)
                return port if len(nodes) == 1 else port[nodes.index(node)]
        raise KeyError(node.name)

    def at_birth(self, node: Node) -> Value:
        """The wire of a value in the cycle of its birth."""
        if node not in self.origin:
            if node.kind == "input":
                value = self.entering[node.name]
            else:
                value = Signal(node.shape, name=node.name)
                operands = [self.read(operand, self.plan.start[node]) for operand in node.operands]
                lets = (self.namer(node.name),) if node.lets else ()
                self.m.d.comb += value.eq(node.fn(*lets, *operands))
            self.origin[node] = value
        return self.origin[node]

    def namer(self, prefix: str) -> Let:
        """A `let` function, which gives intermediate values of a node's logic named wires."""
        def let(name: str, value: Value) -> Signal:
            wire = Signal(value.shape(), name=f"{prefix}_{name}")
            self.m.d.comb += wire.eq(value)
            return wire
        return let

    def operators(self) -> None:
        """The instances of operators, and the operands that they read in each phase."""
        instances = []
        for kind, users in self.plan.instances.items():
            for i, nodes in enumerate(users):
                name = f"{kind.name}_{i}"
                module = replace(kind, registered=False)  # its registers are not in the module
                instance = add_shared(self.m, self.platform, name, kind.name, _make, module)
                self.origin.update(dict.fromkeys(nodes, instance.result))
                instances.append((name, kind, instance, nodes))
        for name, kind, instance, nodes in instances:
            valid = Cat(self.now(self.plan.start[node]) for node in nodes).any()
            enter = self.entry(name, kind, instance, valid)
            for port, operand in enumerate(kind.ports):
                def value(node: Node, port: int = port) -> Value:
                    return self.read(node.operands[port], self.plan.start[node])

                def key(node: Node, port: int = port) -> tuple[Node, int, int]:
                    operand, start = node.operands[port], self.plan.start[node]
                    return operand, self.plan.place(operand, start), self.era(operand, start)

                self.choose(enter(operand), f"{name}_{operand}", nodes, value, key)
            if hasattr(instance, "subtract"):
                self.choose(enter("subtract"), f"{name}_subtract", nodes, lambda node: Const(node.subtract, 1),
                            lambda node: node.subtract)

    def entry(self, name: str, kind: Operator, instance: FloatUnit, valid: Value) -> Callable[[str], Value]:
        """Drives an instance's `valid`, and gives for each of its ports the value to drive: the port itself, or the input of
        its register."""
        if not kind.registered:
            self.m.d.comb += instance.valid.eq(valid)
            return lambda port: getattr(instance, port)
        enter, entered = Signal(name=f"{name}_enter"), Signal(name=f"{name}_entered")
        self.m.d.comb += [enter.eq(valid), instance.valid.eq(entered)]
        self.m.d.sync += entered.eq(enter)

        def register(port: str) -> Value:
            to = getattr(instance, port)
            chosen = Signal(Value.cast(to).shape(), name=f"{name}_{port}_chosen")
            held = Signal.like(chosen, name=f"{name}_{port}_held", reset_less=True)
            with self.m.If(enter):
                self.m.d.sync += held.eq(chosen)
            self.m.d.comb += Value.cast(to).eq(held)
            return chosen

        return register

    def choose(
        self, port: Value, name: str, nodes: list[Node], value: Callable[[Node], Value], key: Callable[[Node], object],
    ) -> None:
        """Drives an instance's port with the value of the operation whose turn it is in the current phase. A source that is
        used in several phases takes one input of the multiplexer only."""
        phases: dict[object, tuple[Node, list[int]]] = {}
        for node in nodes:
            phases.setdefault(key(node), (node, []))[1].append(self.plan.start[node] % self.interval)
        if len(phases) == 1:
            self.m.d.comb += port.eq(value(nodes[0]))
            return
        total = Const(0, len(Value.cast(port)))
        for node, turns in phases.values():
            turn = Cat(self.phase[p] for p in turns).any()
            total = total | Mux(turn, Value.cast(value(node)), 0)
        self.m.d.comb += port.eq(total)

    def registers(self) -> None:
        """The chains of registers that delay values: register i loads when its slot is `i * interval` cycles past the birth."""
        for node, chain in self.chain.items():
            birth, value = self.plan.birth(node), self.at_birth(node)
            for i, register in enumerate(chain):
                with self.m.If(self.now(birth + i * self.interval)):
                    self.m.d.sync += register.eq(value)
                value = register

    def queue(self) -> None:
        """The output queue."""
        self.output(self.unit.source, self.free, self.enter, self.now)

    def output(
        self, source: stream.Interface, free: Signal, enter: Value, now: Callable[[int], Value], prefix: str = "",
    ) -> None:
        """An output queue: outputs are written into their slot's row at their birth, and rows are read in order to the
        source. `now` is that method, or what it finds of those slots that leave here; `enter` says that one enters."""
        m, plan, rows = self.m, self.plan, self.plan.depth
        fetch, read, done = Signal(), Signal(range(rows)), Signal(range(rows + 1))
        fields = {name: (node.shape, self.at_birth_of(node), plan.birth(node)) for name, node in plan.graph.outputs.items()}
        if self.unit._carried is not None:
            fields["carried"] = (self.unit._carried, self.entering.carried, 0)
        for born in sorted({born for _, _, born in fields.values()}):
            kept = {name: (of, value) for name, (of, value, b) in fields.items() if b == born}
            self.rows(kept, source, now(born), fetch, read, f"{prefix}{born}")
        finished = now(plan.length)
        m.d.comb += fetch.eq((done != 0) & (source.ready | ~source.valid))
        m.d.sync += [free.eq(free + fetch - enter), done.eq(done + finished - fetch)]
        with m.If(source.ready | ~source.valid):
            m.d.sync += source.valid.eq(done != 0)
        with m.If(fetch):
            m.d.sync += read.eq(_next(read, rows))

    def at_birth_of(self, node: Node) -> Value:
        """The value of an output at its birth; views of nodes are applied."""
        return as_value(node.fn(self.at_birth_of(node.operands[0]))) if node.kind == "view" else self.at_birth(node)

    def rows(
        self, fields: dict[str, tuple[ShapeLike, Value]], source: stream.Interface, born: Value, fetch: Value, read: Value,
        name: str,
    ) -> None:
        """The memory of a queue for the outputs that are born in the same cycle."""
        m, rows = self.m, self.plan.depth
        layout = data.StructLayout({name: of for name, (of, _) in fields.items()})
        m.submodules[f"rows_{name}"] = words = memory.Memory(shape=layout, depth=rows, init=[])
        write_port, read_port, write = words.write_port(), words.read_port(), Signal(range(rows), name=f"write_{name}")
        m.d.comb += [
            write_port.en.eq(born), write_port.addr.eq(write), read_port.en.eq(fetch), read_port.addr.eq(read)]
        for field, (_, value) in fields.items():
            m.d.comb += [write_port.data[field].eq(value), source.payload[field].eq(read_port.data[field])]
        with m.If(write_port.en):
            m.d.sync += write.eq(_next(write, rows))


def _next(pointer: Signal, rows: int) -> Value:
    return Mux(pointer == rows - 1, 0, pointer + 1)
