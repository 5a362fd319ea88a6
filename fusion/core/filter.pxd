cdef Py_ssize_t AT_ONCE
cdef double FINE, ROUNDING

cpdef void move(
    double[::1] x, double[:, ::1] P, Py_ssize_t n, double ux, double uy, double turn, double qxx, double qxy,
    double qxt, double qyy, double qyt, double qtt, double[:, ::1] J, Py_ssize_t k, Py_ssize_t first,
    Py_ssize_t states)
cpdef double whiten(
    double[:, ::1] P, Py_ssize_t n, Py_ssize_t[::1] at, Py_ssize_t states, double[:, ::1] H, double[:, ::1] S,
    double[::1] y, Py_ssize_t m, double[:, ::1] V)
@cython.locals(greatest=cython.double)
cpdef double projected(
    double[:, ::1] P, Py_ssize_t n, Py_ssize_t[::1] at, Py_ssize_t states, double[:, ::1] H, double[:, ::1] S,
    Py_ssize_t m, double[:, ::1] V)
cdef bint factor(double[:, ::1] S, Py_ssize_t m)
cdef void correct(
    double[::1] x, double[:, ::1] P, Py_ssize_t n, double[:, ::1] V, double[::1] e, Py_ssize_t m)
cdef void consider(
    double[::1] x, double[:, ::1] P, Py_ssize_t n, double[:, ::1] V, double[::1] e, Py_ssize_t m,
    Py_ssize_t[::1] kept)
cdef void mirror(double[:, ::1] P, Py_ssize_t i, Py_ssize_t first, Py_ssize_t n, double least)
cpdef double take_in(
    double[::1] x, double[:, ::1] P, Py_ssize_t n, Py_ssize_t[::1] at, Py_ssize_t states, double[:, ::1] H,
    double[:, ::1] R, double[::1] y, Py_ssize_t m, double[:, ::1] V, Py_ssize_t[::1] kept, bint some)
cpdef void locate(double[::1] x, double[:, ::1] P, Py_ssize_t first, double[::1] out)
cpdef Py_ssize_t by_local(
    double[::1] x, Py_ssize_t first, double by_x, double by_y, double by_theta, double[::1] row)
cpdef double bent(double tt)
cpdef void swing(double[:, ::1] P, Py_ssize_t n, Py_ssize_t first, double dx, double dy)
cpdef void keep_heading(double[::1] x, double[:, ::1] P, Py_ssize_t n, Py_ssize_t column, double behind)
cpdef void keep_pose(double[::1] x, double[:, ::1] P, Py_ssize_t n, Py_ssize_t column)
