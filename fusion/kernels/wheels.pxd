from libc.math cimport atan2, cos, pi, sin

cdef class Odometer:
    cdef double[::1] t
    cdef double[:, ::1] twist, pose, rolled, silence, matched
    cdef double track, noise
    cdef bint silent, matches

cdef class Intervals:
    cdef double[:, ::1] u, Q, J
    cdef Py_ssize_t row
    cdef bint parameters
    cdef double x, y, theta, begin_x, begin_y, begin_theta, end_x, end_y, end_theta
    cdef double left_x, left_y, left_theta, right_x, right_y, right_theta

cpdef void integrate(Odometer wheels, double[::1] t_from, double[::1] t_to, Intervals out)
cdef Py_ssize_t reading(Odometer wheels, double at)
cdef double passed(Odometer wheels, Py_ssize_t k, double at)
cdef void go_along(Odometer wheels, Py_ssize_t k, double share, Intervals out)
cdef void go_arc(double ahead, double left, double turned, Intervals out)
cdef void add_piece(Odometer wheels, Py_ssize_t k, double begin, double end, Intervals out)
cdef double aside(double ahead, double left)
cdef void derive_by_wheels(double track, double direction, double by_x, double by_y, Intervals out)
cdef void add_wheels(Odometer wheels, Py_ssize_t k, double share, Intervals out)
cdef void add_error(Intervals out, double variance, double x, double y, double theta)
cdef void add_match(
    Odometer wheels, Py_ssize_t k, double share, double heading, double by_x, double by_y, Intervals out)
cdef void see_from_begin(Intervals out)
