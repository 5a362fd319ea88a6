cdef Py_ssize_t ROOM

cpdef void between(
    Odometer w, double[::1] t_from, double[::1] t_to, Py_ssize_t n, double[:, ::1] u, double[:, ::1] Q,
    double[:, ::1] J, double[::1] room)
cdef Py_ssize_t reading(double[::1] t, Py_ssize_t n, double at)
cdef double passed(double[::1] t, Py_ssize_t k, double at)
cdef void along(Odometer w, Py_ssize_t k, double share, double[::1] room, Py_ssize_t to)
cdef void arc(
    double x, double y, double theta, double ahead, double left, double turned, double[::1] room, Py_ssize_t to)
cdef void piece(
    Odometer w, Py_ssize_t k, double begin, double end, Py_ssize_t i, double[:, ::1] Q, double[:, ::1] J,
    double[::1] room)
cdef double aside(double ahead, double left)
cdef void by_wheels(double track, double direction, double by_x, double by_y, double[::1] room)
cdef void add_wheels(Odometer w, Py_ssize_t k, double share, Py_ssize_t i, double[:, ::1] Q, double[::1] room)
cdef void add(double[:, ::1] Q, Py_ssize_t i, double variance, double x, double y, double theta)
cdef void add_match(
    Odometer w, Py_ssize_t k, double share, double c, double s, double by_x, double by_y, Py_ssize_t i,
    double[:, ::1] Q)
cdef void seen_from_begin(
    Odometer w, Py_ssize_t i, double[:, ::1] u, double[:, ::1] Q, double[:, ::1] J, double[::1] room)
