cdef Py_ssize_t MAX_STRAY_BEAMS, MAX_CORNER_BEAMS
cdef double MAX_CORNER_SHARE, MIN_CORNER_SINE, FAR

cdef double distance(double[::1] x, double[::1] y, Py_ssize_t i, Py_ssize_t j)
cdef Py_ssize_t long_enough(
    double[::1] x, double[::1] y, Py_ssize_t[::1] first, Py_ssize_t[::1] bounds, Py_ssize_t groups,
    double min_points, double min_length, double[::1] m, Py_ssize_t[::1] start, Py_ssize_t[::1] stop)
cdef bint near(
    double[::1] x, double[::1] y, Py_ssize_t head, Py_ssize_t tail, Py_ssize_t next_head, Py_ssize_t next_tail,
    Py_ssize_t between, double bridge, double max_gap)
cdef void link_parts(
    double[::1] x, double[::1] y, Py_ssize_t[::1] start, Py_ssize_t[::1] stop, Py_ssize_t parts, double bridge,
    double max_gap, Py_ssize_t[::1] linked)
cdef Py_ssize_t close_ring(
    double[::1] x, double[::1] y, Py_ssize_t k, Py_ssize_t[::1] start, Py_ssize_t[::1] stop,
    Py_ssize_t[::1] bounds, Py_ssize_t walls, double[::1] m, double bridge, double max_gap, double limit,
    Py_ssize_t[::1] room)
cdef void rotate(Py_ssize_t[::1] values, Py_ssize_t n, Py_ssize_t by, Py_ssize_t[::1] room)
cdef void perpendicular_fit(double[::1] m, Py_ssize_t walls, double[::1] r, double[::1] psi)
cdef void corner_limits(
    double[::1] d, double[::1] x, double[::1] y, Py_ssize_t k, Py_ssize_t[::1] start, Py_ssize_t[::1] stop,
    Py_ssize_t[::1] bounds, Py_ssize_t walls, bint closed, double[::1] r, double[::1] psi, double sigma_range,
    double sigma_angle, double sigmas, double max_gap, double[::1] low, double[::1] high)
cdef void limit_end(
    double[::1] x, double[::1] y, Py_ssize_t head, Py_ssize_t tail, double psi, double corner, double margin,
    Py_ssize_t i, double[::1] low, double[::1] high)
cdef void limit_begin(
    double[::1] x, double[::1] y, Py_ssize_t head, Py_ssize_t tail, double psi, double corner, double margin,
    Py_ssize_t i, double[::1] low, double[::1] high)
