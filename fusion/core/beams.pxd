cdef double GAP

cdef Py_ssize_t gather(
    double[::1] ranges, double[::1] cos, double[::1] sin, double[::1] x0, double[::1] y0, Py_ssize_t scan,
    Py_ssize_t column, Py_ssize_t beams, Py_ssize_t begin, double low, double high, double[::1] d, double[::1] ux,
    double[::1] uy, double[::1] ox, double[::1] oy, double[::1] x, double[::1] y, Py_ssize_t[::1] beam)
cdef double gap(double dx, double dy, double d, double before, double growth, double max_gap) noexcept
cdef Py_ssize_t ring_start(
    double[::1] d, double[::1] x, double[::1] y, Py_ssize_t k, double growth, double max_gap)
cdef Py_ssize_t cut_at_gaps(
    double[::1] d, double[::1] x, double[::1] y, Py_ssize_t k, double growth, double max_gap, Py_ssize_t[::1] first)
