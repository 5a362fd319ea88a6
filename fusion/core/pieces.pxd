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
cdef double NONE

cdef void tolerances(
    double[::1] d, Py_ssize_t k, double sigma_range, double sigma_angle, double sigmas, double floor,
    double[::1] tolerance)
cdef Py_ssize_t farthest(double[::1] x, double[::1] y, double[::1] tolerance, Py_ssize_t begin, Py_ssize_t end)
cdef Py_ssize_t split(
    double[::1] x, double[::1] y, double[::1] tolerance, Py_ssize_t runs, Py_ssize_t[::1] run_first,
    Py_ssize_t[::1] todo, Py_ssize_t[::1] first, Py_ssize_t[::1] linked)
cdef void moments(
    double[::1] d, double[::1] ux, double[::1] uy, double[::1] x, double[::1] y, Py_ssize_t[::1] first,
    Py_ssize_t pieces, double sigma_range, double sigma_angle, double flatness, double[::1] m)
cdef double misfit(double w, double sx, double sy, double sxx, double sxy, double syy) noexcept
cdef double joint_misfit(double[::1] m, Py_ssize_t i, Py_ssize_t j)
cdef void join(double[::1] m, Py_ssize_t i, Py_ssize_t j)
cdef double own_misfit(double[::1] m, Py_ssize_t i)
cdef Py_ssize_t merge(
    double[::1] m, Py_ssize_t pieces, Py_ssize_t[::1] linked, double limit, double[::1] own, double[::1] cost,
    Py_ssize_t[::1] after, Py_ssize_t[::1] before, Py_ssize_t[::1] best, Py_ssize_t[::1] bounds)
cdef Py_ssize_t cheapest(
    double[::1] cost, Py_ssize_t[::1] after, Py_ssize_t[::1] before, Py_ssize_t pieces, double limit,
    Py_ssize_t[::1] best)
cdef void join_pairs(
    double[::1] m, double[::1] own, double[::1] cost, Py_ssize_t[::1] after, Py_ssize_t[::1] before,
    Py_ssize_t[::1] best, Py_ssize_t chosen)
cdef void renew_cost(double[::1] m, double[::1] own, double[::1] cost, Py_ssize_t[::1] after, Py_ssize_t i)
cdef Py_ssize_t compact(double[::1] m, Py_ssize_t[::1] after, Py_ssize_t pieces, Py_ssize_t[::1] bounds)
