"""Error messages for Python: command-line options in a message become keyword arguments.

"Set it first: --set wheels.track=0.3 --align se2" becomes 'Set it first: sets={"wheels.track": 0.3} align="se2"'.
A LocfuseError keeps the original message in `typed`, for commands that call the same functions.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from functools import wraps
from typing import ParamSpec, TypeVar

from locfuse.formats.robot.robot_toml import apply_sets
from locfuse.fusion.data import LocfuseError

P = ParamSpec("P")
R = TypeVar("R")
WORD = r"""(?:'[^']*'|"[^"]*"|\[[^\]]*\]|<[^>]*>|[^\s,;:()'"\[<])+"""
SETTING = rf"--set {WORD}"
SETTINGS = re.compile(rf"{SETTING}(?: {SETTING})*")
COMMAND = re.compile(rf"(?<=: )locfuse (info|compare|tune|calibrate)((?: {WORD})+)(?=$|[,;)])")
OPTIONS = {  # option -> keyword argument in Python; {} is the option's value
    **{name: f'{name}="{{}}"' for name in ("align", "order", "preset", "robot")},
    **{name: name for name in ("sensors", "sweep", "write", "export")},
    "all-subsets": "all_subsets=True",
    "estimate": "estimates",
    "from": "between=({}, None)",
    "jitter": "jitter={}",
    "map": "with_map",
    "no-reference": "reference=False",
    "no-smooth": "smooth=False",
    "overwrite": "overwrite=True",
    "reference": "reference=True",
    "save-map": "save_map",
    "set": "sets",
    "smooth": "smooth=True",
    "to": "between=(None, {})",
}
AS_CALL = re.compile(r'locfuse\.load\(("[^"]*")(.*?)\)\.(findings|tune|calibrate)\(\)')
OPTION = re.compile(rf"--({'|'.join(sorted(OPTIONS, key=len, reverse=True))})(?![\w-])(?: (?!--)({WORD}))?(:?)")


def in_python(words: str) -> str:
    """Return a message with command-line options and commands replaced by Python code."""
    words = COMMAND.sub(lambda found: _call(found[1], shlex.split(found[2])), words)
    words = re.sub(r"--from (\S+) --to ([^\s:]+)", r"between=(\1, \2)", words)
    words = SETTINGS.sub(lambda found: _sets(shlex.split(found[0])), words)
    return OPTION.sub(_keyword, words)


def in_tools(words: str) -> str:
    """Return a message with command-line options replaced by arguments of the tools of `locfuse mcp`."""

    def call(found: re.Match[str]) -> str:
        log, rest, method = found.groups()
        return f"info({log}{rest}, check=true)" if method == "findings" else f"{method}([{log}]{rest})"

    words = AS_CALL.sub(call, in_python(words)).replace("sets={", "settings={")
    words = re.sub(r"\blocfuse\.(info|compare)\(", r"\1(", words)
    return re.sub(r"([:=] ?)(True|False)\b", lambda found: found[0].lower(), words)


def speaks_python(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function so that its LocfuseErrors name keyword arguments instead of options."""

    @wraps(function)
    def call(*args: P.args, **keywords: P.kwargs) -> R:
        try:
            return function(*args, **keywords)
        except LocfuseError as problem:
            problem.typed = problem.typed or str(problem)
            problem.args = (in_python(problem.typed),)
            raise

    return call


def _call(command: str, words: Sequence[str]) -> str:
    """Return a command of locfuse (with its words) as a Python call."""
    log, given, sets = "", list[str](), list[str]()
    rest = iter(words)
    for word in rest:
        if word == "--set":
            sets.append(next(rest, ""))
        elif word == "--robot":
            given.append(f'robot="{next(rest, "")}"')
        elif not word.startswith("-"):
            log = log or word
    arguments = ", ".join((f'"{log}"', *given, *([_sets(sets)] if sets else [])))
    if "--check" in words:
        return f"locfuse.load({arguments}).findings()"
    direct = f"locfuse.{command}({arguments})"
    return direct if command in {"info", "compare"} else f"locfuse.load({arguments}).{command}()"


def _sets(words: Sequence[str]) -> str:
    """Return `--set a.b=1 --set a.c=x` as sets={"a.b": 1, "a.c": "x"}; placeholders (<...>) are kept."""
    pairs = (word.partition("=") for word in words if word != "--set")
    inside = ", ".join(f'"{key}": {_value(text)}' for key, _, text in pairs)
    return f"sets={{{inside}}}"


def _value(text: str) -> str:
    if not text or text[0] == "<":
        return text or "..."
    value = apply_sets([f"key={text}"])["key"]
    return repr(value) if not isinstance(value, str) else text if text[0] == "[" else f'"{value}"'


def _keyword(found: re.Match[str]) -> str:
    """Return a matched option as a keyword argument; only its name if it lacks its value or a colon follows."""
    option, value, colon = found.groups()
    keyword = OPTIONS[option]
    if "{}" in keyword and value is not None:
        return keyword.format(value) + colon
    name = keyword.partition("=")[0] if "{}" in keyword or (colon and value is None) else keyword
    return name + (f" {value}" if value is not None else "") + colon
