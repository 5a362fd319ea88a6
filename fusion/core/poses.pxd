cdef Py_ssize_t SEEN_FROM

cpdef void see_from(double[::1] a, double[::1] b, double[::1] out)
cpdef void way_noise(
    double[::1] u, double by_way, double turn_by_way, double arm, double floor, double turn_floor, double[::1] out)
cpdef void turned_noise(double[::1] R, double angle, double[::1] out)
cdef double posed(Belief b, Poses p, Py_ssize_t i, Desk d)
cdef Py_ssize_t in_map(Belief b, Poses p, Py_ssize_t i, Desk d)
cdef void since_kept(Belief b, Poses p, Py_ssize_t i, Desk d)
cdef void moved_by_source(Poses p, Py_ssize_t i, Desk d)
cdef void see_kept(Belief b, Py_ssize_t at, Desk d)
cdef void begin_pose(Belief b, Poses p, Py_ssize_t i, Desk d)
cdef void carry(double[::1] x, double[:, ::1] P, Py_ssize_t n, Py_ssize_t column, double[::1] u)
