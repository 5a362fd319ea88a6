"""List the packages, and compile the kernels: without a C compiler the install succeeds and they run interpreted.

Everything else about the package stands in pyproject.toml. Each fusion/kernels/*.py with a .pxd beside it becomes
an extension. With LOCFUSE_KERNELS=checked every access to an array is checked, for tests: slower.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError

FOLDERS = ("cli", "formats", "fusion", "robots", "sample_logs")
KERNELS, BUILD = Path("fusion/kernels"), Path("build/kernels")
PACKAGE = "locfuse.fusion.kernels"
ABI = "0x030B0000"  # Python 3.11 and later: one wheel for each platform
CHECKED = os.environ.get("LOCFUSE_KERNELS") == "checked"
DIRECTIVES = {
    "language_level": 3,
    "annotation_typing": False,  # annotations are for readers and mypy, C types stand in the .pxd
    "infer_types": True,
    "cdivision": True,
    "wraparound": False,
    "initializedcheck": False,
    "boundscheck": CHECKED,
    # but for a checked access nothing in a kernel raises: no caller asks
    "legacy_implicit_noexcept": not CHECKED,
}


def packages(root: Path) -> dict[str, str]:
    """Return the folder of each package: cli/facade is `locfuse`, every other folder with code lies below it."""
    inits = sorted(path for top in FOLDERS for path in (root / top).rglob("__init__.py"))
    folders = [path.parent.relative_to(root).as_posix() for path in inits]
    return {"locfuse" if f == "cli/facade" else "locfuse." + f.replace("/", "."): f for f in folders}


def mirrored() -> Path:
    """Copy the kernels to where their package says they are, so that Cython finds one from another."""
    shutil.rmtree(BUILD, ignore_errors=True)
    folder = BUILD.joinpath(*PACKAGE.split("."))
    shutil.copytree(KERNELS, folder, ignore=shutil.ignore_patterns("*.so", "*.pyd", "__pycache__"))
    for parent in (folder.parent, folder.parent.parent):
        (parent / "__init__.py").touch()
    return folder


def translated(path: Path) -> str:
    """Translate a kernel into C, and return that file."""
    try:
        from Cython.Build import cythonize
    except ImportError:  # an install without build isolation, where nobody installed Cython
        return path.as_posix()
    unwritten = Extension(f"{PACKAGE}.{path.stem}", [path.as_posix()])
    written = cythonize([unwritten], compiler_directives=DIRECTIVES, include_path=[BUILD.as_posix()], quiet=True)
    return str(written[0].sources[0])


class Build(build_ext):
    """Compile the kernels, with the flags of the compiler that was found."""

    def run(self) -> None:
        """Translate the kernels into C, then build as ever."""
        self.parallel = self.parallel or os.cpu_count()
        folder = mirrored()
        for extension in self.extensions:
            name = extension.name.rpartition(".")[2]
            extension.sources = [translated(folder / f"{name}.py")]
        super().run()

    def build_extension(self, extension: Extension) -> None:
        """Compile one kernel. Raises CompileError, which leaves it interpreted, where it was not translated."""
        if not extension.sources[0].endswith(".c"):
            raise CompileError("Cython is not there")
        extension.extra_compile_args = ["-O3", "-g0", "-ffp-contract=off", "-fno-math-errno"]
        if self.compiler.compiler_type == "msvc":
            extension.extra_compile_args = ["/O2", "/fp:precise"]
        super().build_extension(extension)


if __name__ == "__main__":
    placed = packages(Path())
    setup(
        packages=list(placed),
        package_dir=placed,
        ext_modules=[
            Extension(
                f"{PACKAGE}.{path.stem}",
                [path.with_suffix(".py").as_posix()],
                define_macros=[("Py_LIMITED_API", ABI), ("_USE_MATH_DEFINES", "1")],
                py_limited_api=True,
                optional=True,
            )
            for path in sorted(KERNELS.glob("*.pxd"))
        ],
        cmdclass={"build_ext": Build},
        options={"bdist_wheel": {"py_limited_api": "cp311"}},
    )
