cimport cython

cdef double LEAST_TURN, MOST_TURN, SHADOW, SURE, SPARED, STRAIGHT
cdef Py_ssize_t LEAST_PIECES

cdef Py_ssize_t following(Py_ssize_t walls, bint closed, Py_ssize_t i)
@cython.locals(gap=double, turn=double, way=double, ahead=double)
cdef Py_ssize_t joints(
    double[::1] x, double[::1] y, Py_ssize_t[::1] start, Py_ssize_t[::1] stop, Py_ssize_t[::1] bounds,
    Py_ssize_t walls, bint closed, double[::1] psi, double[::1] joint)
@cython.locals(behind=double, ahead=double)
cdef double curvature_of(double[::1] joint, Py_ssize_t walls, bint closed, Py_ssize_t i)
cdef double gain(
    double[::1] d, double[::1] ux, double[::1] uy, double[::1] ox, double[::1] oy, Py_ssize_t[::1] row,
    Py_ssize_t n, double r, double psi, double ratio, double variance, double bent, double[::1] e, double[::1] q,
    double[::1] w, double[::1] sums)
@cython.locals(sign=double, here=double, at=Py_ssize_t)
cdef void goes_on(
    double[::1] joint, double[::1] gains, Py_ssize_t walls, bint closed, Py_ssize_t i, Py_ssize_t step,
    double[::1] sums)
cdef bint is_piece(
    double[::1] joint, double[::1] gains, Py_ssize_t walls, bint closed, Py_ssize_t i, double length,
    double[::1] sums)
@cython.locals(bent=double, length=double, mean=double, found=Py_ssize_t)
cdef void find_curves(
    double[::1] d, double[::1] ux, double[::1] uy, double[::1] ox, double[::1] oy, double[::1] x, double[::1] y,
    Py_ssize_t[::1] start, Py_ssize_t[::1] stop, Py_ssize_t[::1] bounds, Py_ssize_t walls, bint closed,
    double[::1] r, double[::1] psi, double ratio, double variance, Py_ssize_t[::1] row, double[::1] e,
    double[::1] q, double[::1] w, double[::1] sums, double[::1] joint, double[::1] gains,
    Py_ssize_t[::1] curved)
