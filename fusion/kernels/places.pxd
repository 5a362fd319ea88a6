cimport cython
from libc.math cimport cos, floor, pi, sin, sqrt

cdef double SAME_ANGLE_RAD, SAME_OFFSET_M, MIN_OVERLAP_SHARE, MIN_BEHIND_M, MIN_FROM_END_M, MIN_GRAZING_SINE
cdef Py_ssize_t SIGHT_LINES

cdef enum:
    R, PSI, BEGIN = 5, END

cdef enum:
    RHO, BETA, X, Y, LOW, HIGH, NX, NY

cpdef double wrapped(double angle) noexcept
@cython.locals(psi=double, r=double, cross=double, begin=double, end=double)
cpdef void into_base(double[:, ::1] rows, Py_ssize_t lines, double x, double y, double yaw, double[:, ::1] out)
cpdef void moved(double[::1] place, double[::1] configured, double[::1] out)
cpdef void shares_into_base(
    double[:, ::1] rows, Py_ssize_t lines, double x, double y, double yaw, double[:, :, ::1] shared,
    double[:, :, ::1] out)
cdef void face(double[:, ::1] walls)
cpdef void behind(double[:, ::1] rows, double[:, ::1] walls, double x, double y, double theta, bint both, double[::1] out)
cdef bint blocked(double[:, ::1] walls, double x, double y, double dx, double dy, double reach, bint both)
@cython.locals(total=double, possible=double, share=double)
cpdef void explained(double[:, ::1] rows, double[:, ::1] walls, double[:, ::1] poses, double slack, double[:, ::1] out)
cdef Py_ssize_t likeness(double[:, ::1] rows, double[:, ::1] walls, Py_ssize_t i, double x, double y, double theta, double slack)
cpdef Py_ssize_t hypotheses(
    double[:, ::1] rows, Py_ssize_t a, Py_ssize_t b, double[:, ::1] walls, Py_ssize_t found, double[:, ::1] poses)
cdef double from_origin(double[:, ::1] walls, Py_ssize_t j)
