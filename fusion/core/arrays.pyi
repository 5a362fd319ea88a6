import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints

# a form of the core takes lists (interpreted) or NumPy's arrays (compiled); matrices lie row by row
Floats = list[float] | Array
Wholes = list[int] | Ints
Pixels = memoryview | NDArray[np.uint8]
Points = memoryview | NDArray[np.int32]
Table = memoryview | Ints  # of whole numbers, by two indices
Matrix = memoryview | Array  # by two indices: the same memory as somebody's array, in either form
