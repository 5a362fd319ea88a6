cpdef bint worthless(
    Py_ssize_t[::1] hits, Py_ssize_t[::1] born, Py_ssize_t j, Py_ssize_t scan, Py_ssize_t least, Py_ssize_t trial)
cdef bint one_wall(
    double[:, ::1] rows, double[::1] low, double[::1] high, Py_ssize_t i, Py_ssize_t j, double angle, double offset,
    double apart)
cpdef Py_ssize_t neighbours(
    double[:, ::1] rows, double[::1] low, double[::1] high, Py_ssize_t places, Py_ssize_t i, double angle,
    double offset, double apart, Py_ssize_t[::1] found)
