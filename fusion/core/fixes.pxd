cdef Py_ssize_t FIX

cpdef void fix(
    double x, double y, double theta, double lever_x, double lever_y, double from_x, double from_y, double[::1] tie,
    bint known, double[::1] out)
cdef double locate_fix(Belief b, Fixes f, Py_ssize_t i, Desk d)
