"""A drive that is fused without compiled kernels has the same poses, covariances and map, to 1e-9."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from interpreted import KERNELS

import locfuse

INTERPRETED = """
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
from test_interpreted import fused
fused(sys.argv[3], Path(sys.argv[4]))
import locfuse.fusion.kernels.ekf
assert locfuse.fusion.kernels.ekf.__file__.endswith(".py")
"""
SETTINGS: dict[str, dict[str, Any]] = {
    "grow": {},
    "consider": {"lrf.map": "consider", "wheels.estimate": True},
}


def fused(which: str, folder: Path) -> None:
    """Write what a run of a sample log estimates."""
    found = locfuse.load("disturbed", sets=SETTINGS[which]).run(["compass", "lrf"], advice=False).estimates
    run = found["compass+lrf"]
    lines = [(line.rho, line.beta, *line.ends, *line.P.ravel()) for line in run.final_map]
    np.savez(folder / "run.npz", pose=run.pose, triangles=run.triangles, lines=np.array(lines))


@pytest.mark.parametrize("which", SETTINGS)
def test_a_drive_is_the_same_with_interpreted_kernels(which: str, tmp_path: Path) -> None:
    (tmp_path / "source").mkdir()
    fused(which, tmp_path)
    here = str(KERNELS), str(Path(__file__).parent), which, str(tmp_path / "source")
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1] / "helpers")}
    subprocess.run([sys.executable, "-c", INTERPRETED, *here], check=True, env=env)
    found, source = np.load(tmp_path / "run.npz"), np.load(tmp_path / "source" / "run.npz")
    for name in found.files:
        np.testing.assert_allclose(source[name], found[name], rtol=1e-7, atol=1e-9, err_msg=name)
