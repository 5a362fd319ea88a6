"""What several pages of these tests look at is computed once."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import Done, ok


@pytest.fixture(scope="session")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Done, Path]:
    """The sample log, compared without any option: what was printed, and the folder of its results."""
    out = tmp_path_factory.mktemp("plain") / "out"
    return ok("compare", "rounded_rectangle", "-o", out), out
