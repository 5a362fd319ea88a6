"""What holds for the tests of the house."""

from collections.abc import Iterator

import pytest
from sources import parsed


@pytest.fixture(scope="module", autouse=True)
def _trees_are_forgotten() -> Iterator[None]:
    """A million nodes would make every later sweep for garbage slow."""
    yield
    parsed.cache_clear()
