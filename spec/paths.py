"""Where the project's files are: one place knows it, so that no file counts its own parent folders."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
"""The checkout: the folder that holds `spec`."""

REPORTS = ROOT / "reports"
"""What studies wrote and the project keeps."""

DOCS = ROOT / "docs"
"""Pages, some of them generated."""
