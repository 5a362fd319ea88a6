"""The fields of a message type that can be columns."""

from locfuse.formats.messages.schema import FILLER, Many, Node, Structure


def paths(node: Node, path: str = "", inside: bool = False) -> list[str]:
    if isinstance(node, Structure) and not node.is_time:
        parts = ((f"{path}.{name}".lstrip("."), part) for name, part in node.fields.items() if name != FILLER)
        return [found for name, part in parts for found in paths(part, name, inside)]
    if not isinstance(node, Many):
        return [path]
    if inside or isinstance(node.element, Many):
        return []
    return paths(node.element, path, True) if isinstance(node.element, Structure) else [path]
