"""Judges the copy of the project in which it runs: quick tests, the hard cases on the integer renderer and the oracle, and more
quick tests.

    python -m msv2.cases.source_mutants.worker RESULT [TESTS...] cases [TESTS...]

RESULT becomes JSON: `by`, "case" or "test" where one noticed something, else "", and `words`. The first failure ends the run.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from msv2.cases.source_mutants.contents import keep_by_content

QUICK = "not (rtl or torch or slow or long or data)"
"""The tests that `make check` runs, too."""


def _cases() -> str:
    """The first failure of a case, and what it says."""
    from msv2.cases import registry
    from msv2.cases.check import cell

    for column in ("golden", "oracle"):
        for case in registry.CASES:
            found = cell(case, column)
            if found.outcome == "FAIL":
                return f"{column}, {case.name}: {found.words}"
    return ""


def _tests(paths: list[str]) -> str:
    """The first failure of the quick tests in these folders."""
    if not paths:
        return ""
    import pytest

    failed: list[str] = []

    class Listener:
        def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
            if report.failed:
                failed.append(report.nodeid)

        def pytest_collectreport(self, report: pytest.CollectReport) -> None:
            if report.failed:
                failed.append(report.nodeid)

    status = pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-m", QUICK, *paths], [Listener()])
    return failed[0] if failed else "" if status == 0 else f"pytest ended with {status}"


def main() -> None:
    """Writes the verdict."""
    keep_by_content()
    result, steps = Path(sys.argv[1]), sys.argv[2:]
    at = steps.index("cases")
    verdict = {"by": "", "words": ""}
    for by, step in (("test", lambda: _tests(steps[:at])), ("case", _cases), ("test", lambda: _tests(steps[at + 1 :]))):
        try:
            words = step()
        except Exception as error:  # a module that cannot be imported, or a case that cannot be made
            words = f"{type(error).__name__}: {error}"
        if words:
            verdict = {"by": by, "words": words[:300]}
            break
    result.write_text(json.dumps(verdict))


if __name__ == "__main__":
    main()
