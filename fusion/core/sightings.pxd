cdef double LEAST_SHARE, TOUCHING

cpdef void by_range(double[::1] ray, double x, double y, double share, double[::1] out)
cpdef double shortened(double angle)
cpdef double share_of(double depth, double short)
cpdef void placed(
    double x, double y, double theta, double mount_x, double mount_y, double yaw, double distance, double angle,
    double[::1] out)
cdef bint unknown(Sightings g, Py_ssize_t i)
cdef double detect(Belief b, Sightings g, Py_ssize_t i, bint whole, Desk d)
cdef double detect_one(Belief b, Sightings g, Py_ssize_t row, Desk d)
cdef Py_ssize_t add_place(Sightings g, Py_ssize_t mark, Py_ssize_t states, Py_ssize_t k, Desk d)
cdef Py_ssize_t add_states(Sightings g, Py_ssize_t mark, double short, Py_ssize_t states, Py_ssize_t k, Desk d)
cdef void keep_place(Belief b, Sightings g, Py_ssize_t row, double distance, Py_ssize_t k, Desk d)
