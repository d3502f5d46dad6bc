"""The folders of the project. They are defined here once, so that no other file derives them from its own path."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
"""The checkout: the folder that holds `spec`."""

REPORTS = ROOT / "reports"
"""The reports that studies wrote and the project keeps."""

DOCS = ROOT / "docs"
"""The pages of the documentation, some of which are generated."""
