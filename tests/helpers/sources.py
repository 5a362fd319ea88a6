"""Our sources as trees: parsed once for all tests of the house that read them."""

import ast
from functools import cache


@cache
def parsed(text: str) -> ast.Module:
    return ast.parse(text)
