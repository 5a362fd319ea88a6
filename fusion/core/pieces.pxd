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
