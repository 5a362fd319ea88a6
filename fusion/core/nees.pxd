@cython.locals(whole=cython.double)
cpdef void nees(
    double[:, ::1] e, double[:, ::1] S, Py_ssize_t rows, Py_ssize_t d, double least, double[:, ::1] L, double[::1] w,
    double[::1] out)
cdef double of_inverse(double[:, ::1] L, Py_ssize_t d, double[::1] w)
cdef double squared(double[:, ::1] L, Py_ssize_t d, double[::1] w, Py_ssize_t first)
