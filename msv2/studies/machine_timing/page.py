"""The report of the linked machines as a Markdown page."""

from __future__ import annotations

from collections.abc import Mapping

from msv2.studies.page import table

SHOWN = 40
"""Pairs of units in a table; the JSON has all."""


def page(report: Mapping[str, object]) -> str:
    """The whole page."""
    corners = report["corners"]
    about = "; ".join(f"{name}: {corner['node']}" + (f", memories x {corner['memory_factor']:.2f} ({corner['memory_source']})"
                                                      if corner["memory_source"] else "") for name, corner in corners.items())
    intro = (
        "Written by `msv2 study run machine_timing`. All mapped modules of a machine are linked and timed by OpenSTA as one, "
        f"at {report['clock_ps']:,.0f} ps with {report['uncertainty']:.0%} clock uncertainty. Nothing is a black box; memories "
        "are cells with their macros' times. Clocks are ideal and there are no wires. How it is done, and what could be done "
        f"about late paths: [synthesis.md](../docs/synthesis.md). Corners: {about}.")
    parts = ["# The machine timed as one", intro, _summary(report)]
    for name, machine in report["machines"].items():
        parts += [f"## {name}", _machine(name, machine)]
        for corner in corners:
            parts += [f"### {name}, {corner}: late endpoints by pair of units", _pairs(machine[corner]["pairs"])]
        parts += [f"### {name}: the budget rule, typical", *_measured_later(machine), _budget(machine["budget"]),
                  f"### {name}: nets beyond their driver's limit", _overloads(machine)]
    return "\n\n".join(parts) + "\n"


def _count(value: float) -> str:
    return f"{value:,.0f}"


def _summary(report: Mapping) -> str:
    rows = [(f"`{name}`", corner, f"{machine[corner]['slack_ps']:,.1f}", _count(machine[corner]["late_endpoints"]),
             _count(len(machine[corner]["pairs"])), f"{machine[corner]['ghz']:.2f}", f"{machine[corner]['hold_slack_ps']:,.1f}",
             _count(machine[corner]["hold_endpoints"]), _count(machine[corner]["slew_nets"]))
            for name, machine in report["machines"].items() for corner in report["corners"]]
    return table(("machine", "corner", "worst slack, ps", "late endpoints", "late pairs of units", "GHz at zero slack",
                  "worst hold slack, ps", "endpoints that miss hold", "nets with slow transitions"), rows, 2)


def _machine(name: str, machine: Mapping) -> str:
    return (f"Commit {machine['commit']}, at most {machine['runs']} runs of a module: {machine['modules']} modules, "
            f"{machine['instances']:,} instances, {machine['cells']:,} cells." + _held(machine))


def _held(machine: Mapping) -> str:
    """What was added against misses of hold."""
    if not machine.get("hold_buffers"):
        return ""
    return (f" {machine['hold_buffers']:,} of the cells are buffers before memories' pins that would change too soon after the "
            f"clock ({machine['hold_um2']:,.1f} um2, in no other report).")


def _measured_later(machine: Mapping) -> list[str]:
    """At which later commit the stored times of ports are of the machine's RTL, and how many are not of the linked run."""
    if "budget_commit" not in machine:
        return []
    again, commit, runs = machine["budget_modules"], machine["budget_commit"], machine["budget_runs"]
    if not again:
        return [f"At commit {commit} the RTL of all its modules is still that of the linked run."]
    modules = "1 module was" if again == 1 else f"{again} modules were"
    return [f"Since the linked run, {modules} mapped again, with at most {runs} runs, and measured. At commit {commit} the RTL "
            "of all others is still that of the linked run."]


def _more(shown: int, found: int) -> str:
    return f"\n\n{found - shown:,} more are in the JSON." if found > shown else ""


def _pairs(pairs: list) -> str:
    rows = [(f"{pair['slack_ps']:,.1f}", _count(pair["endpoints"]), " > ".join(f"`{unit}`" for unit in pair["through"]))
            for pair in pairs[:SHOWN]]
    return table(("slack, ps", "endpoints", "units that the latest path crosses"), rows, 0, (
        "units that the latest path crosses",), "None.") + _more(SHOWN, len(pairs))


def _budget(pairs: list) -> str:
    rows = [(_count(pair["excess_ps"]), f"`{pair['start']}`", f"`{pair['end']}`", " > ".join(pair["way"]))
            for pair in pairs[:SHOWN]]
    return table(("ps too long", "from", "to", "ports on the way"), rows, 0, ("from", "to", "ports on the way"),
                 "None.") + _more(SHOWN, len(pairs))


def _overloads(machine: Mapping) -> str:
    rows = [(f"`{one['module']}`", f"`{one['net']}`", f"{one['load_ff']:,.1f}", f"{one['limit_ff']:,.1f}")
            for one in machine["overloads"]]
    text = table(("module", "net", "load, fF", "limit, fF"), rows, 2, (), "None.")
    return f"{machine['overloaded_nets']:,} nets; the worst:\n\n{text}" if rows else text
