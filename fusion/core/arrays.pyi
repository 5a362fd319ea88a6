from locfuse.fusion.data import Array, Ints

# a form of the core takes lists (interpreted) or NumPy's arrays (compiled); matrices lie row by row
Floats = list[float] | Array
Wholes = list[int] | Ints
Matrix = memoryview | Array  # by two indices: the same memory as somebody's array, in either form
