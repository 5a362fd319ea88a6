cpdef void extend(
    double[::1] pairs, Py_ssize_t[::1] fate, Py_ssize_t lines, double[::1] low, double[::1] high,
    Py_ssize_t[::1] hits, Py_ssize_t[::1] seen, Py_ssize_t scan)
cpdef Py_ssize_t lacks(
    double[:, ::1] P, Py_ssize_t[::1] columns, Py_ssize_t places, double rho, double beta, Py_ssize_t[::1] at,
    double[::1] missing)
