from libc.math cimport floor, pi

cpdef double wrapped(double angle) noexcept
