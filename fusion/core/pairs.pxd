cdef Py_ssize_t WALL, PAIR
cdef double FACE_SIGMAS, MAX_ANGLE, NOWHERE

cpdef void gather_walls(
    double[::1] x, double[:, ::1] P, Py_ssize_t[::1] columns, double[:, ::1] anchors, Py_ssize_t places,
    Py_ssize_t[::1] at, Py_ssize_t free, double[:, ::1] walls)
cpdef void gather_mount(double[:, ::1] P, Py_ssize_t[::1] at, Py_ssize_t free, double[::1] mount)
cdef void predict(double[::1] walls, Py_ssize_t width, Py_ssize_t places, double[::1] pose, double[::1] seen)
cpdef Py_ssize_t pairs(
    double[::1] rows, Py_ssize_t lines, double[::1] walls, Py_ssize_t width, double[::1] low, double[::1] high,
    Py_ssize_t places, bint states, double[::1] pose, double[::1] P, double[::1] mount, Py_ssize_t free,
    double max_turn, double max_offset, double sigmas, double limit, double[::1] seen, double[::1] out)
cdef void spread(
    double[::1] rows, Py_ssize_t i, double[::1] walls, Py_ssize_t width, Py_ssize_t j, bint states,
    double[::1] pose, double[::1] P, double[::1] mount, Py_ssize_t free, double side, double[::1] seen,
    double[::1] out, Py_ssize_t at)
cdef void seat(
    double[::1] walls, Py_ssize_t w, double[::1] mount, Py_ssize_t free, double[::1] out, Py_ssize_t at)
cdef double lever(double[::1] mount, Py_ssize_t a, double c, double s)
cdef bint fits(double distance, double limit, double[::1] out, Py_ssize_t at)
cdef void extent(
    double[::1] rows, Py_ssize_t i, double[::1] walls, Py_ssize_t width, Py_ssize_t j, double[::1] pose,
    double side, double[::1] low, double[::1] high, double[::1] out, Py_ssize_t at)
