"""JSON Schemas of robot.toml, report.json and --json output, made from their types.

Draft 7 of JSON Schema is used, since TOML editors (taplo, Even Better TOML) support no newer one: they read tuples
of draft 2020-12 as empty.
"""

from __future__ import annotations

import inspect
import re
import tokenize
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from io import StringIO
from typing import Any

import msgspec

from locfuse.cli.analysis.robot_tables import table_types
from locfuse.cli.analysis.settings import ORDERS, PRESETS
from locfuse.formats.report import structure
from locfuse.fusion.sensors.registry import REGISTRY

DRAFT_7 = "http://json-schema.org/draft-07/schema#"
REF_TEMPLATE = "#/$defs/{name}"
OF_ORDER = "Which times to trust: header stamps, recording order, or whichever fits (auto)."
OF_PRESET = "The filter: locfuse's own (default), or the paper's equations as printed (paper)."
FIELD_PATTERN = re.compile(r"\s+(\w+)\s*:")  # the start of a field's line
Schema = dict[str, Any]


def robot_schema() -> Schema:
    """Return the JSON schema of robot.toml: every table and key; unknown keys are errors."""
    types = table_types()
    refs, definitions = msgspec.json.schema_components(list(types.values()), ref_template=REF_TEMPLATE)
    for name, kind in types.items():
        asks = REGISTRY[name].asks if name in REGISTRY else {}
        words = {**{key: ask.words for key, ask in asks.items()}, **field_words(kind)}
        _describe(definitions[kind.__name__], words)
        for schema in definitions[kind.__name__]["properties"].values():  # without null, since TOML has none
            kinds = [part for part in schema.pop("anyOf", []) if part != {"type": "null"}]
            schema.update(kinds[0] if len(kinds) == 1 else {"anyOf": kinds} if kinds else {})
            if schema.get("default", 0) is None:
                del schema["default"]
    top = {
        "order": {"enum": list(ORDERS), "default": "auto", "description": OF_ORDER},
        "preset": {"enum": list(PRESETS), "default": "default", "description": OF_PRESET},
    }
    return {
        "$schema": DRAFT_7,
        "title": "robot.toml",
        "description": "A robot for locfuse. SI units; angles in degrees where the key ends in _deg.",
        "type": "object",
        "properties": {**top, **dict(zip(types, refs, strict=True))},
        "additionalProperties": False,
        "$defs": _in_draft_7(definitions),
    }


def output_schema(title: str, *kinds: type[msgspec.Struct]) -> Schema:
    """Return the JSON schema of an output of one of these types; unknown keys are valid, for later ones."""
    refs, definitions = msgspec.json.schema_components(kinds, ref_template=REF_TEMPLATE)
    for name, definition in definitions.items():
        _describe(definition, field_words(getattr(structure, name)))
    top = refs[0] if len(refs) == 1 else {"anyOf": list(refs)}
    return {"$schema": DRAFT_7, "title": title, **top, "$defs": _in_draft_7(definitions)}


def _describe(definition: Schema, words: Mapping[str, str]) -> None:
    for key, schema in definition.get("properties", {}).items():
        if key in words:
            schema["description"] = words[key]


def _in_draft_7(schema: Any) -> Any:
    """Return the schema with tuples in the form of JSON Schema draft 7."""
    if isinstance(schema, list):
        return [_in_draft_7(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    parts = {key: _in_draft_7(part) for key, part in schema.items()}
    if (items := parts.pop("prefixItems", None)) is not None:
        same = all(item == items[0] for item in items)
        parts |= {"items": items[0]} if same else {"items": items, "additionalItems": False}
    return parts


def field_words(kind: type[Any]) -> dict[str, str]:
    """Return the comment of each field of a class and its bases (meaning, unit); {} without source code."""
    words: dict[str, str] = {}
    for part in reversed(kind.__mro__):
        if part.__module__.startswith("locfuse."):
            words |= dict(_commented(part))
    return words


def _commented(kind: type[Any]) -> Iterator[tuple[str, str]]:
    """Yield (field, comment) of each annotated line of a class that ends with a comment."""
    try:
        source = inspect.getsource(kind)
    except (OSError, TypeError):  # shipped without its source
        return
    lines = source.splitlines()
    for token in tokenize.generate_tokens(StringIO(source).readline):
        field = FIELD_PATTERN.match(lines[token.start[0] - 1]) if token.type == tokenize.COMMENT else None
        if field is not None and field.end() < token.start[1]:
            yield field[1], token.string.lstrip("# ")


SCHEMAS: dict[str, Callable[[], Schema]] = {
    "robot": robot_schema,
    "report": partial(output_schema, "report.json", structure.Report),
    "info": partial(output_schema, "info --json", structure.InfoOutput, structure.TopicsOutput),
    "tune": partial(output_schema, "tune --json", structure.TuneOutput),
    "calibrate": partial(output_schema, "calibrate --json", structure.CalibrateOutput),
}
