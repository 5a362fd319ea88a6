"""Compiled inner loops (Cython); without a compiler the same files run interpreted.

A kernel is a Python file; the .pxd file of the same name declares its C types. Python imports the compiled
extension if there is one, else the Python file. Both give the same numbers to 1e-9; the Python file is many times
slower (docs/kernels.md).
"""
