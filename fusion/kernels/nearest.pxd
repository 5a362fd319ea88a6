cimport cython
from libc.math cimport floor

cdef double ROW_M, FAR_ROWS

cdef class Best:
    cdef double square
    cdef Py_ssize_t point

cdef class CloudRows:
    cdef Py_ssize_t[::1] first, begin, point
    cdef double[::1] bottom, x, y
    cdef Best best

cpdef void find_nearest(
    CloudRows rows, double[:, ::1] xy, Py_ssize_t[::1] cloud, double reach, Py_ssize_t[::1] out)
@cython.locals(level=double, low=double, away=double, count=Py_ssize_t, begin=Py_ssize_t, k=Py_ssize_t)
cdef void search(CloudRows rows, double x, double y, Py_ssize_t cloud, Best best)
@cython.locals(
    dx=double, dy=double, begin=Py_ssize_t, end=Py_ssize_t, low=Py_ssize_t, high=Py_ssize_t, middle=Py_ssize_t,
    i=Py_ssize_t)
cdef void search_row(CloudRows rows, Py_ssize_t row, double x, double y, Best best)
