"""Compiled inner loops (Cython); without a compiler the same files run interpreted.

A kernel is a Python file with its C types in the .pxd beside it. Where it was compiled, Python imports the
extension; where not, the file itself, on memoryviews: same numbers to 1e-9, many times slower (docs/kernels.md).
"""
