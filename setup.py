"""Compile fusion/core where there is a C compiler; without one the install succeeds and the source is interpreted.

Everything else about the package stands in pyproject.toml. The core's files become one unit, so that calls between
them are calls in C: each .py without its imports of the others, typed by the .pxd beside it. With
LOCFUSE_CORE=checked every access to an array is checked, for tests: slower.
"""

from __future__ import annotations

import os
import re
import runpy
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError

CORE, BUILD = Path("fusion/core"), Path("build/core")
PACKAGE = "locfuse.fusion.core"
FORM = runpy.run_path(str(CORE / "form.py"), run_name="form")
IMPORTS = re.compile(r"^from (?:\.\w+|math) import (?:\([^)]*\)|[^\n]*)\n", re.MULTILINE)
CHECKED = os.environ.get(FORM["VARIABLE"]) == "checked"
MOST_AXES = 2  # of an array; what is passed of one has room for so many
ABI = "0x030B0000"  # Python 3.11 and later: one wheel for each platform
DIRECTIVES = {
    "language_level": 3,
    "infer_types": True,
    "cdivision": True,
    "wraparound": False,
    "initializedcheck": False,
    "boundscheck": CHECKED,
    # but for a checked access, and room that `extract` asks for, nothing in the core raises: no caller asks
    "legacy_implicit_noexcept": not CHECKED,
}


def unit() -> Path:
    """Write the core's files as one, and return it."""
    folder = BUILD.joinpath(*PACKAGE.split("."))  # where Cython looks for the types of a module of that name
    folder.mkdir(parents=True, exist_ok=True)
    code = ['"""The core, compiled."""\n']
    types = ["cimport cython\nfrom libc.math cimport atan2, cos, exp, floor, log, pi, sin, sqrt, tan\n"]
    for name in FORM["SOURCES"]:
        text = (CORE / f"{name}.py").read_text(encoding="utf-8")
        code.append(IMPORTS.sub("", text.split('"""', 2)[2]))  # without the docstring
        types.append((CORE / f"{name}.pxd").read_text(encoding="utf-8"))
    code.append(f"\nSOURCE = {FORM['fingerprint'](CORE)}\nCHECKED = {CHECKED}\n")
    path = folder / f"{FORM['COMPILED']}.py"
    path.write_text("\n".join(code), encoding="utf-8")
    path.with_suffix(".pxd").write_text("\n".join(types), encoding="utf-8")
    return path


def translated() -> str:
    """Translate the unit into C, and return that file."""
    try:
        from Cython.Build import cythonize
        from Cython.Compiler import Options
    except ImportError as e:  # an install without build isolation, where nobody installed Cython
        raise CompileError("Cython is not there") from e
    Options.buffer_max_dims = MOST_AXES + 1  # Cython wants more than there are
    unwritten = Extension(f"{PACKAGE}.{FORM['COMPILED']}", [unit().as_posix()])
    written = cythonize([unwritten], compiler_directives=DIRECTIVES, include_path=[BUILD.as_posix()], quiet=True)
    return str(written[0].sources[0])


class Build(build_ext):
    """Compile the core, with the flags of the compiler that was found."""

    def build_extension(self, extension: Extension) -> None:
        """Keep a * b + c two operations, so that both forms of the core agree to the last bit."""
        extension.sources = [translated()]
        extension.extra_compile_args = ["-O3", "-g0", "-ffp-contract=off", "-fno-math-errno"]
        if self.compiler.compiler_type == "msvc":
            extension.extra_compile_args = ["/O2", "/fp:precise"]
        super().build_extension(extension)


setup(
    ext_modules=[
        Extension(
            f"{PACKAGE}.{FORM['COMPILED']}",
            [],
            define_macros=[("Py_LIMITED_API", ABI), ("_USE_MATH_DEFINES", "1")],
            py_limited_api=True,
            optional=True,
        )
    ],
    cmdclass={"build_ext": Build},
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
