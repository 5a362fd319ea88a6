cdef Py_ssize_t RAY

cpdef bint bearing(
    double[::1] pose, double to_x, double to_y, double x, double y, double yaw, double nearest, double[::1] out)
cdef double sight(Belief b, Bearings g, Py_ssize_t i, Desk d)
cdef double judge_each(Bearings g, Py_ssize_t i, double predicted, double variance, double more)
cpdef Py_ssize_t choose(
    double[:, ::1] told, Py_ssize_t first, Py_ssize_t last, double gate, double margin, double refused,
    double ambiguous, double unmatched)
