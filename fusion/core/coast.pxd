cdef Py_ssize_t HEARD

cpdef double coast(
    double[::1] x, double[:, ::1] P, Py_ssize_t n, Py_ssize_t frame, Py_ssize_t first, Py_ssize_t last,
    double[:, ::1] u, double[:, ::1] Q, double[::1] dt, Py_ssize_t[::1] drifting, double[::1] drift,
    Py_ssize_t drifts, Py_ssize_t[::1] when, Py_ssize_t reading, Py_ssize_t stop, double[::1] z, double[::1] r,
    Py_ssize_t[::1] usable, double gate, double refused, double unused, double offset, Py_ssize_t[::1] at,
    Py_ssize_t states, double[::1] room, double[::1] y, double[:, ::1] S, double[:, ::1] H, double[:, ::1] V,
    double[:, ::1] pose, double[:, ::1] triangle, Py_ssize_t[::1] columns, Py_ssize_t blocks,
    double[:, ::1] values, double[:, ::1] told)
cdef double heading(
    double[::1] x, double[:, ::1] P, Py_ssize_t n, Py_ssize_t frame, double z, double r, double gate,
    double refused, Py_ssize_t[::1] at, Py_ssize_t states, double[::1] y, double[:, ::1] S, double[:, ::1] H,
    double[:, ::1] V, double[:, ::1] told, Py_ssize_t i)
cdef void correct_in_frame(
    double[::1] x, double[:, ::1] P, Py_ssize_t n, Py_ssize_t frame, double[:, ::1] V, double[::1] e)
cpdef void note(
    double[::1] x, double[:, ::1] P, Py_ssize_t frame, double[::1] room, Py_ssize_t k, double[:, ::1] pose,
    double[:, ::1] triangle, Py_ssize_t[::1] columns, Py_ssize_t blocks, double[:, ::1] values)
