"""NumPy's warnings, silenced for a whole process: the one place where that is done.

Absurd readings (1e300 m, NaN) overflow on their way to the gate that counts and reports them. NumPy's
RuntimeWarning about it names a line of ours and no reading, so it helps nobody at a terminal. `import locfuse`
silences nothing.
"""

from __future__ import annotations

import warnings


def silence_overflows() -> None:
    """Ignore RuntimeWarning from here on, in this process."""
    warnings.simplefilter("ignore", RuntimeWarning)
