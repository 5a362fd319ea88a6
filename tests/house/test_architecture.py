"""The house: who may import whom, what lies where, and what ships.

Rooms form floors. A room imports only from floors below its own, so data flows one way and there are no circles.
"""

import ast
import re
import runpy
import sys
import tomllib
from collections.abc import Callable, Mapping
from functools import cache, partial
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import pytest
from sources import parsed

pytestmark = pytest.mark.usefixtures("unswept")
ROOT = Path(__file__).parents[2]
FOLDERS = ("fusion", "formats", "sample_logs", "robots", "cli")
STANDARD = set(sys.stdlib_module_names)
LAZY = {"rerun", "matplotlib", "scipy", "jinja2"}  # only inside the function that needs them
DRAWS_IN_RERUN = {  # imported by formats/rerun/recording.py, inside its functions
    f"formats/rerun/{name}.py" for name in ("blueprint", "drawing", "map_view", "series")
}
# Floors, lowest first. A name is a room, or a file at the root of a top folder.
FLOORS: dict[str, tuple[str, ...]] = {
    "fusion": (
        "data progress se2",
        "geodesy kernels statistics streams",
        "camera scan_matching sensor",
        "ekf lines mount robot",
        "wheels",
        "map truth",
        "sensors",
        "checks measure",
        "fuse judge",
        "paper tune whole_drive",
    ),
    "formats": (
        "columns geometry text versions",
        "figures inputs",
        "report robot whole_files",
        "container rerun",
        "messages",
        "logs",
        "results",
    ),
    "sample_logs": (),
    "robots": (),
    "cli": ("analysis", "advice inspect", "session", "rerun ros", "fleet", "terminal", "commands main", "facade"),
}
# what each top folder may import besides itself and the standard library
OURS = {
    "cli": {"fusion", "formats", "sample_logs", "robots"},
    "robots": set[str](),
    "fusion": set[str](),
    "formats": {
        "fusion.data",
        "fusion.streams",
        "fusion.kernels.built",
        "fusion.progress",
        "fusion.se2",
        "fusion.camera.opencv",  # pictures are decoded in one place, whose limits and silence maps need too
    },
    "sample_logs": {"formats", "fusion.se2", "fusion.data"},
}
OTHERS = {
    "fusion": {"numpy", "msgspec", "cv2", "scipy", "cython"},
    "sample_logs": {"numpy", "msgspec", "cv2", "tomli_w"},
}
TERMINAL = {  # only here: click, rich, print
    "cli/commands",
    "cli/terminal",
    "cli/main.py",
}
CV2 = {"fusion/camera", "formats/robot/map_image.py", "fusion/checks/preview.py"}


def teardown_module() -> None:
    """A million nodes would make every later sweep for garbage slow."""
    parsed.cache_clear()


def files(folder: str) -> list[Path]:
    return sorted(path for path in (ROOT / folder).rglob("*.py"))


def name_of(path: Path) -> str:
    """Return "fusion.ekf.rows" of fusion/ekf/rows.py, "fusion.ekf" of its __init__.py."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for folder in FOLDERS for path in files(folder)}


@cache
def imports(path: Path) -> list[tuple[str, bool]]:
    """Return (module as "fusion.data" or "numpy", whether it is imported at module level)."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    tree = parsed(path.read_text(encoding="utf-8"))
    deferred = (ast.FunctionDef, ast.ClassDef)
    now = [n for n in tree.body if not isinstance(n, deferred) and not types_only(n)]
    top = set(ast.walk(ast.Module(now, [])))
    found: list[tuple[str, bool]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(alias.name.removeprefix("locfuse."), node in top) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(p for p in (base, node.module or "") if p)
            module = module.removeprefix("locfuse").removeprefix(".")
            for alias in node.names:
                below = f"{module}.{alias.name}".removeprefix(".")
                found.append((below if below in MODULES else module, node in top))
    return found


def types_only(node: ast.stmt) -> bool:
    """Tell `if TYPE_CHECKING:`, whose imports never run."""
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def arrows() -> dict[str, set[str]]:
    """Return which files of ours each file imports, anywhere in it."""
    return {name: {m for m, _ in imports(path) if m in MODULES and m != name} for name, path in MODULES.items()}


def room_of(module: str) -> str:
    """Return "fusion.ekf" of "fusion.ekf.rows"; a file at the root of a top folder is a room of its own."""
    return ".".join(module.split(".")[:2])


def circle(graph: Mapping[str, set[str]]) -> list[str]:
    """Return the nodes of a circle, the first one again at its end; nothing where there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as found:
        return list(found.args[1])
    return []


def test_no_file_imports_itself_in_a_circle_and_a_circle_is_seen() -> None:
    assert circle(arrows()) == []
    assert set(circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}})) == {"a", "b", "c"}


LEVEL = {
    f"{top}.{room}": level
    for top, floors in FLOORS.items()
    for level, rooms in enumerate(floors)
    for room in rooms.split()
}


def test_a_room_imports_only_from_floors_below() -> None:
    own = {module: room_of(module) for module in MODULES if FLOORS[module.split(".")[0]] and "." in module}
    assert set(own.values()) <= set(LEVEL), "give each room a floor in FLOORS"
    wrong = [
        f"{module} imports {other}, which is not below it"
        for module, others in arrows().items()
        for other in others
        if module in own and other.split(".")[0] == module.split(".")[0]
        if (below := room_of(other)) != own[module] and "." in below and LEVEL[below] >= LEVEL[own[module]]
    ]
    assert wrong == []


def test_imports_follow_the_one_way_flow() -> None:
    for path in MODULES.values():
        folder = path.relative_to(ROOT).parts[0]
        for module, top in imports(path):
            root = module.split(".")[0]
            if root in FOLDERS and root != folder:
                allowed = OURS[folder]
                assert any(module == a or module.startswith(a + ".") for a in allowed), f"{path} imports {module}"
            elif root not in FOLDERS and root not in STANDARD and root != "locfuse" and folder in OTHERS:
                assert root in OTHERS[folder], f"{path} imports {module}"
            if top and not (root == "rerun" and path.relative_to(ROOT).as_posix() in DRAWS_IN_RERUN):
                assert root not in LAZY, f"{path} imports {root} at module level"


def test_imports_are_relative_inside_a_room_and_absolute_across() -> None:
    for path in MODULES.values():
        own = "locfuse." + ".".join(path.relative_to(ROOT).parent.parts)
        for node in ast.walk(parsed(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom):
                continue
            assert node.level <= 1, f"{path}:{node.lineno} climbs out of its room"
            module = node.module or ""
            if node.level == 0 and path.parent.name != "facade" and module.startswith(own):
                is_file = module.removeprefix("locfuse.") in MODULES and module.rpartition(".")[0] == own
                folder = (ROOT / module.removeprefix("locfuse.").replace(".", "/")).is_dir()
                assert folder or not (is_file or module == own), f"{path}:{node.lineno} names its own room in full"


def rooms() -> list[Path]:
    found = [d for top in FOLDERS if FLOORS[top] for d in (ROOT / top).iterdir() if (d / "__init__.py").exists()]
    return sorted(found)


def test_a_room_says_what_it_is_for_and_exports_nothing_else() -> None:
    for room in rooms():
        if room.name == "facade":
            continue
        assert not [d for d in room.iterdir() if d.is_dir() and d.name != "__pycache__"], "rooms hold no rooms"
        tree = parsed((room / "__init__.py").read_text(encoding="utf-8"))
        assert ast.get_docstring(tree), room
        assert len(tree.body) == 1, f"{room}: a room's __init__ is its docstring"


def test_only_the_terminal_prints_and_knows_click_and_rich() -> None:
    for path in MODULES.values():
        where = path.relative_to(ROOT).as_posix()
        if any(where == t or where.startswith(t + "/") for t in TERMINAL):
            continue
        assert not {"click", "rich"} & {module.partition(".")[0] for module, _ in imports(path)}, where
        nodes = ast.walk(parsed(path.read_text(encoding="utf-8")))
        calls = [n.func for n in nodes if isinstance(n, ast.Call)]
        assert not [f for f in calls if isinstance(f, ast.Name) and f.id == "print"], where


def test_only_the_camera_imports_opencv() -> None:
    users = {
        path.relative_to(ROOT).as_posix()
        for folder in ("cli", "fusion", "formats")
        for path in files(folder)
        for module, _ in imports(path)
        if module.split(".")[0] == "cv2"
    }
    assert not {u for u in users if u not in CV2 and str(Path(u).parent.as_posix()) not in CV2}, users


def test_every_folder_with_code_ships() -> None:
    """Every .py and data file of the tree lies in a package that setup.py finds, under its own name."""
    listed = {folder: name for name, folder in runpy.run_path(str(ROOT / "setup.py"))["packages"](ROOT).items()}
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    kinds = {".py", *(Path(pattern).suffix for pattern in settings["package-data"]["*"])}
    for top in FOLDERS:
        for path in (ROOT / top).rglob("*"):
            if not path.is_file() or "__pycache__" in path.parts or path.name == "README.md":
                continue
            if path.suffix in {".so", ".pyd"}:  # made of the kernels where locfuse is installed
                continue
            folder = path.parent.relative_to(ROOT).as_posix()
            expected = "locfuse" if folder == "cli/facade" else "locfuse." + folder.replace("/", ".")
            assert listed.get(folder) == expected, f"{folder} has no __init__.py: setup.py does not find it"
            assert path.suffix in kinds or path.name in settings["package-data"]["*"], f"{path} would not ship"


LINK = re.compile(r"\]\((?!https?:|#)([^)#\s]+)")
MODULE = re.compile(
    r"`(?:locfuse\.)?((?:cli|fusion|formats|sample_logs|benchmarks)(?:[./][a-z_0-9]+)+)(?:\.py)?[^`]*`"
)
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "sample_logs").glob("*.md")])


def test_docs_name_files_and_modules_that_exist() -> None:
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for link in LINK.findall(text):
            assert (page.parent / link).exists(), f"{page.name} links to {link}"
        for name in MODULE.findall(text):
            parts = re.split(r"[./]", name.removesuffix(".py").removesuffix("."))
            places = [ROOT.joinpath(*parts[:n]) for n in (len(parts), len(parts) - 1) if n > 1]
            there = [
                p.is_dir() or p.with_suffix(".py").exists() or any(p.parent.glob(p.name + ".*")) for p in places
            ]
            assert any(there), f"{page.name} names {name}"


def test_the_floors_name_only_rooms_that_exist() -> None:
    named = [f"{top}.{room}" for top, floors in FLOORS.items() for floor in floors for room in floor.split()]
    assert len(named) == len(set(named))
    for name in named:
        path = ROOT / name.replace(".", "/")
        assert path.is_dir() or path.with_suffix(".py").exists(), name


# --- the caps of the house: arguments of a function, fields of a record, what changes in a class, lines of a file

MAX_ARGUMENTS = 8  # of a function, without self; a command's are its options: cli/commands has no cap
MAX_RECORD_FIELDS = 12  # of a dataclass, NamedTuple or Struct, without those that it inherits
MAX_CHANGING_FIELDS = 10  # of a class: what methods other than __init__ assign, or assign into
MAX_FILE_LINES = 600
# --- what is over a cap today
ARGUMENTS: dict[str, int] = {}
RECORD_FIELDS: dict[str, int] = {
    "formats/figures/panels.py:Panel": 16,
    "formats/report/structure.py:ReportedResult": 30,
    "formats/rerun/scene.py:RerunScene": 15,
    "fusion/data.py:Drive": 14,
    "fusion/data.py:Estimates": 20,
    "fusion/data.py:Evaluation": 17,
    "fusion/judge/innovations.py:OwnInnovations": 13,
    "fusion/lines/extract.py:LineSettings": 19,
    "fusion/map/line_map.py:LineMap": 13,
    "fusion/robot.py:WheelSettings": 29,
}
CHANGING_FIELDS: dict[str, int] = {
    "fusion/ekf/belief_arrays.py:JointBelief": 15,
    "fusion/kernels/ekf.py:State": 20,
    "fusion/kernels/sight.py:SightLines": 22,
    "fusion/map/guard.py:Guard": 13,
    "fusion/map/line_map.py:LineMap": 13,
    "fusion/map/tracker.py:AtlasTracker": 12,
    "fusion/map/tracker.py:LineTracker": 13,
    "fusion/whole_drive/smooth.py:Backward": 13,
}
FILE_LINES: dict[str, int] = {}
Function = ast.FunctionDef | ast.AsyncFunctionDef
Named = Function | ast.ClassDef
RECORDS = {"NamedTuple", "Struct"}
BIRTH = {"__init__", "__post_init__", "__new__", "__cinit__"}
FILES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for folder in FOLDERS
    for path in sorted((ROOT / folder).rglob("*.py"))
}


def definitions(text: str) -> list[tuple[str, ast.AST]]:
    """Return (dotted name, definition) of every function and class, however deep it lies."""
    found: list[tuple[str, ast.AST]] = []
    waiting: list[tuple[str, ast.AST]] = [("", parsed(text))]
    while waiting:
        name, node = waiting.pop()
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.expr):  # holds none
                continue
            below = f"{name}.{child.name}".removeprefix(".") if isinstance(child, Named) else name
            if isinstance(child, Named):
                found.append((below, child))
            waiting.append((below, child))
    return found


def defined(text: str, kind: Any) -> list[tuple[str, ast.AST]]:
    return [(name, node) for name, node in definitions(text) if isinstance(node, kind)]


def arguments(function: ast.AST) -> int:
    assert isinstance(function, Function)
    a = function.args
    names = [x.arg for x in (*a.posonlyargs, *a.args, *a.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def last_name(node: ast.AST) -> str:
    """Return "dataclass" of dataclass, dataclasses.dataclass and dataclass(frozen=True)."""
    while isinstance(node, ast.Call | ast.Subscript):
        node = node.func if isinstance(node, ast.Call) else node.value
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def record_fields(cls: ast.AST) -> int:
    """Count the fields of a record; 0 of another class."""
    assert isinstance(cls, ast.ClassDef)
    made = any(last_name(d) == "dataclass" for d in cls.decorator_list)
    if not made and not RECORDS & {last_name(base) for base in cls.bases}:
        return 0
    fields = [n for n in cls.body if isinstance(n, ast.AnnAssign)]
    return len([n for n in fields if last_name(n.annotation) != "ClassVar"])


def changing_fields(cls: ast.AST) -> int:
    """Count the fields of self that methods other than __init__ assign, or assign into."""
    assert isinstance(cls, ast.ClassDef)
    found = set()
    for method in cls.body:
        if not isinstance(method, Function) or method.name in BIRTH:
            continue
        for node in ast.walk(method):
            if not isinstance(node, ast.Attribute | ast.Subscript) or isinstance(node.ctx, ast.Load):
                continue
            inner: ast.AST = node
            while isinstance(inner, ast.Subscript):
                inner = inner.value
            if isinstance(inner, ast.Attribute) and last_name(inner.value) == "self":
                found.add(inner.attr)
    return len(found)


def over(cap: int, counted: Mapping[str, int]) -> dict[str, int]:
    return {name: count for name, count in counted.items() if count > cap}


def functions(files: Mapping[str, str]) -> dict[str, int]:
    here = {f: text for f, text in files.items() if not f.startswith("cli/commands/")}
    return {f"{f}:{name}": arguments(x) for f, text in here.items() for name, x in defined(text, Function)}


def classes(files: Mapping[str, str], count: Callable[[ast.AST], int]) -> dict[str, int]:
    return {f"{f}:{name}": count(x) for f, text in files.items() for name, x in defined(text, ast.ClassDef)}


records = partial(classes, count=record_fields)
changing = partial(classes, count=changing_fields)


def lengths(files: Mapping[str, str]) -> dict[str, int]:
    return {f: len(text.splitlines()) for f, text in files.items()}


CAPS: dict[str, tuple[int, Callable[[Mapping[str, str]], dict[str, int]], dict[str, int]]] = {
    "arguments": (MAX_ARGUMENTS, functions, ARGUMENTS),
    "record fields": (MAX_RECORD_FIELDS, records, RECORD_FIELDS),
    "changing fields": (MAX_CHANGING_FIELDS, changing, CHANGING_FIELDS),
    "lines": (MAX_FILE_LINES, lengths, FILE_LINES),
}


@pytest.mark.parametrize("what", CAPS)
def test_nothing_is_over_its_cap_but_what_was_so_when_the_caps_were_set(what: str) -> None:
    cap, count, known = CAPS[what]
    today = over(cap, count(FILES))
    more = {name: n for name, n in today.items() if n > known.get(name, 0)}
    assert not more, f"more than {cap} {what}, or more than before: {more}"
    less = {name: today.get(name, 0) for name, n in known.items() if today.get(name, 0) < n}
    assert not less, f"mended: write the smaller number, or take it off the list where it is 0: {less}"


def same_names(files: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the files of every class name that stands twice."""
    places: dict[str, list[str]] = {}
    for file, text in files.items():
        for name, _ in defined(text, ast.ClassDef):
            places.setdefault(name.rpartition(".")[2], []).append(file)
    return {name: where for name, where in places.items() if len(where) > 1}


def test_a_class_name_stands_once() -> None:
    assert same_names(FILES) == {}
    assert same_names({"a.py": "class A:\n    class B: ...\n", "b.py": "class B: ...\n"}) == {
        "B": ["a.py", "b.py"]
    }


def test_the_caps_see_what_is_over_them() -> None:
    many = "\n".join(f"    x{i}: int = 0" for i in range(13))
    words = ", ".join(f"x{i}" for i in range(9))
    sets = "\n".join(f"        self.x{i} = self.y[{i}] = 0" for i in range(10))
    files = {
        "fusion/a.py": f"def far(*, {words}): ...\nclass A(NamedTuple):\n{many}\n",
        "fusion/c.py": f"@dataclass(frozen=True)\nclass B:\n{many}\n",
        "fusion/b.py": f"class C:\n    def go(self, {words}):\n{sets}\n    def __init__(self):\n{sets}\n",
        "cli/commands/a.py": f"def far({words}): ...\n",
        "fusion/long.py": "\n" * 601,
    }
    assert over(8, functions(files)) == {"fusion/a.py:far": 9, "fusion/b.py:C.go": 9}
    assert over(12, records(files)) == {"fusion/a.py:A": 13, "fusion/c.py:B": 13}
    assert over(10, changing(files)) == {"fusion/b.py:C": 11}
    assert over(600, lengths(files)) == {"fusion/long.py": 601}
