"""What the C of the kernels must not do, and how a process says that its kernels are interpreted."""

import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from interpreted import KERNELS, interpreted
from msgspec.structs import replace
from rooms import ARENA, poses, scan

import locfuse
from locfuse.fusion.data import Array
from locfuse.fusion.kernels.built import INTERPRETED, how
from locfuse.fusion.lines import extract
from locfuse.fusion.lines.extract import LineSettings, RawScans, motion_of

NAMES = sorted(path.stem for path in KERNELS.glob("*.pxd"))
OBJECTS = re.compile(r"PyFloat_(From|As)Double|PyLong_From|PyNumber_|PyObject_RichCompare")
MADE = r"\s*def |.*[A-Z]\w+\("  # how Python calls a method, and records that are made, are of objects
# what these take or give are Python's own: tuples of a sensor, more room, a pose
METHODS = "compare|write_row|replace|make_room|variance|of|noise_of|pose|pose_in_map|room_for|judge"
METHODS += "|correct_queued|state_rows"
BORDER = re.compile(rf"_({METHODS})\(")
TRANSLATE = """
import runpy, setuptools, sys
setuptools.setup = lambda **k: None
build = runpy.run_path("setup.py")
folder = build["mirrored"]()
for name in sys.argv[1:]:
    print(name, build["translated"](folder / f"{name}.py"))
"""


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The kernels' sources and setup.py, without what was built."""
    folder = tmp_path_factory.mktemp("kernels")
    built = shutil.ignore_patterns("*.so", "*.pyd", "__pycache__")
    shutil.copytree(KERNELS.parent, folder / "fusion", ignore=built)
    shutil.copy(KERNELS.parents[1] / "setup.py", folder)
    return folder


def test_no_number_of_a_compiled_kernel_is_an_object(sources: Path) -> None:
    """Where Cython cannot tell a type it takes an object, silently: 20 times slower (`cython.locals` tells it)."""
    pytest.importorskip("Cython")
    command = (sys.executable, "-c", TRANSLATE, *NAMES)
    code = subprocess.run(command, cwd=sources, capture_output=True, text=True, check=True)
    written = dict(line.split() for line in code.stdout.splitlines() if line.startswith(tuple(NAMES)))
    assert written.keys() == set(NAMES)
    for name, file in written.items():
        text = (sources / file).read_text(encoding="utf-8")
        source = re.escape(f'"locfuse/fusion/kernels/{name}.py"')
        lines = (KERNELS / f"{name}.py").read_text(encoding="utf-8").splitlines()
        line, inside, found = 0, False, set()
        for row in text.splitlines():
            if row.startswith(("static", "}")):
                inside = "__pyx_f_" in row and row.endswith("{") and "unpickle" not in row
                inside = inside and not BORDER.search(row)
            elif at := re.match(rf" */\* {source}:(\d+)", row):
                line = int(at[1])
            elif inside and OBJECTS.search(row) and not re.match(MADE, lines[line - 1]):
                found.add(lines[line - 1].strip())
        assert line > 0, name
        assert not found, (name, found)
        # no exception ends in a warning on stderr and no result; methods only look for one of a subclass
        unraised = re.findall(r'__Pyx_WriteUnraisable\("(locfuse\.fusion\.kernels\.\w+\.[a-z]\w*)"', text)
        assert not unraised, name


def test_without_a_compiled_kernel_the_version_says_that_it_is_slower(sources: Path) -> None:
    """Asked of a copy that has no extension, and of the command itself."""
    folder = sources / "fusion" / "kernels"
    code = f"import sys; sys.path.insert(0, {str(folder.parent)!r}); from kernels.built import how; print(how())"
    assert run("-c", code) == INTERPRETED
    assert run("-m", "locfuse", "--version").endswith(f"(kernels {INTERPRETED})") == (how() == INTERPRETED)


def run(*arguments: str) -> str:
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=True)
    return done.stdout.strip()


# --- a drive that is fused without compiled kernels has the same poses, covariances and map, to 1e-9

WITHOUT_KERNELS = """
import sys
from importlib.util import spec_from_file_location
from pathlib import Path

class Sources:
    def find_spec(self, name, path=None, target=None):
        package, _, kernel = name.rpartition(".")
        source = Path(sys.argv[1]) / f"{kernel}.py"
        here = package == "locfuse.fusion.kernels" and source.is_file()
        return spec_from_file_location(name, source) if here else None

sys.meta_path.insert(0, Sources())
sys.path.insert(0, sys.argv[2])
from test_compiled import fused
fused(sys.argv[3], Path(sys.argv[4]))
import locfuse.fusion.kernels.ekf
assert locfuse.fusion.kernels.ekf.__file__.endswith(".py")
"""
SETTINGS: dict[str, dict[str, Any]] = {"grow": {}, "consider": {"lrf.map": "consider", "wheels.estimate": True}}


def fused(which: str, folder: Path) -> None:
    """Write what a run of a sample log estimates."""
    session = locfuse.load("disturbed", sets=SETTINGS[which], between=(None, 40.0))
    run = session.run(["compass", "lrf"], advice=False, smooth=False).filtered
    lines = [(line.rho, line.beta, *line.ends, *line.P.ravel()) for line in run.final_map]
    np.savez(folder / "run.npz", pose=run.pose, triangles=run.triangles, lines=np.array(lines))


@pytest.mark.parametrize("which", SETTINGS)
def test_a_drive_is_the_same_with_interpreted_kernels(which: str, tmp_path: Path) -> None:
    (tmp_path / "source").mkdir()
    fused(which, tmp_path)
    here = str(KERNELS), str(Path(__file__).parent), which, str(tmp_path / "source")
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1] / "helpers")}
    subprocess.run([sys.executable, "-c", WITHOUT_KERNELS, *here], check=True, env=env)
    found, source = np.load(tmp_path / "run.npz"), np.load(tmp_path / "source" / "run.npz")
    for name in found.files:
        np.testing.assert_allclose(source[name], found[name], rtol=1e-7, atol=1e-9, err_msg=name)


# --- lines by the compiled kernels and by their source interpreted are the same, and no input makes either fail

MOUNT = motion_of(np.array([0.2, -0.1, 0.4]))
NUMBERS = st.one_of(
    st.floats(0.05, 30.0),
    st.sampled_from([math.nan, math.inf, -math.inf, 0.0, -1.0, 1e-300, 1e5, 1e30, 2.0, 2.0, 2.0]),
)


def agree(scans: RawScans, how: LineSettings | None = None, moving: bool = False) -> extract.Lines:
    """Return the lines, after the interpreted kernels gave the same."""
    asked = scans, how or LineSettings(), MOUNT if moving else None
    found = extract.lines_of(*asked)
    with pytest.MonkeyPatch.context() as patch:
        for name in ("segments", "line_fits"):
            patch.setattr(extract, name, interpreted(name))
        other = extract.lines_of(*asked)
    for name in extract.Lines.__struct_fields__:
        np.testing.assert_allclose(getattr(other, name), getattr(found, name), rtol=1e-9, atol=1e-9, err_msg=name)
    return found


def seen(angles: Array, n: int, seed: int = 0) -> Array:
    """Noisy scans of a room with plates in it (n, b), some beams lost."""
    rng = np.random.default_rng(seed)
    real = angles + rng.normal(0.0, math.radians(0.25), (n, len(angles)))
    d = np.array([scan(ARENA, p, a) for p, a in zip(poses(rng, n), real, strict=True)])
    d += rng.normal(0.0, 0.03, d.shape)
    d[rng.uniform(size=d.shape) < 0.05] = math.inf
    return d


@settings(deadline=None, max_examples=150)
@given(st.data(), st.integers(0, 60), st.integers(0, 3), st.booleans(), st.booleans())
def test_no_scan_makes_either_differ(data: st.DataObject, beams: int, n: int, ring: bool, moving: bool) -> None:
    numbers = data.draw(st.lists(NUMBERS, min_size=n * beams, max_size=n * beams))
    step = data.draw(st.sampled_from([0.0, 1e-9, math.radians(0.5), 0.1]))
    angles: Array = np.arange(beams, dtype=np.float64) * (2.0 * math.pi / max(beams, 1) if ring else step)
    offsets = None
    if moving:
        few = st.sampled_from([0.0, 0.0, 0.01, -0.02, 1e30, math.nan])
        offsets = np.resize(data.draw(st.lists(few, min_size=7, max_size=7)), (n, beams, 3))
    with np.errstate(all="ignore"):
        agree(RawScans(np.array(numbers, np.float64).reshape(n, beams), angles, offsets), moving=moving)


NUMERIC = ("sigma_angle", "min_points", "min_length", "max_gap", "gap_spacings", "bridge", "split_floor")


@settings(deadline=None, max_examples=80)
@given(st.integers(0, 10_000), st.sampled_from(NUMERIC), st.sampled_from([0.0, 1e-6, 1.0, 1e6]))
def test_no_setting_makes_either_fail_or_differ(seed: int, name: str, value: float) -> None:
    angles = np.linspace(-math.pi, math.pi, 90, endpoint=False)
    d: Array = np.round(seen(angles, 1, seed), 1)  # to 10 cm: many points lie alike
    how = replace(LineSettings(flatness=0.0), **{name: cast("Any", value)})
    agree(RawScans(d, angles, None), how)


@pytest.mark.parametrize("shape", [(0, 361), (3, 0), (3, 1), (3, 2), (0, 0)])
def test_nothing_to_see_is_no_line(shape: tuple[int, int]) -> None:
    lines = agree(RawScans(np.full(shape, 2.0), np.linspace(-1.0, 1.0, shape[1]), np.zeros((*shape, 3))))
    assert len(lines.z) == 0
