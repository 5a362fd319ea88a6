"""Kernels as they run where nothing is compiled, beside those that this process imports."""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

KERNELS = Path(__file__).parents[2] / "fusion" / "kernels"
PACKAGE = "interpreted_kernels"


class Sources(MetaPathFinder):
    """Finds the kernels' sources as another package, whatever extension stands beside them."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        package, _, name = fullname.partition(".")
        if package != PACKAGE:
            return None
        places = None if name else [str(KERNELS)]
        return spec_from_file_location(
            fullname, KERNELS / f"{name or '__init__'}.py", submodule_search_locations=places
        )


def interpreted(name: str) -> Any:
    """Return a kernel, interpreted, with all its functions."""
    if not any(isinstance(finder, Sources) for finder in sys.meta_path):
        sys.meta_path.insert(0, Sources())
    return import_module(f"{PACKAGE}.{name}")
