cdef double HUGE

cdef Py_ssize_t rows_of(
    Py_ssize_t[::1] start, Py_ssize_t[::1] stop, Py_ssize_t begin, Py_ssize_t end, Py_ssize_t[::1] row)
cdef void residuals(
    double[::1] d, double[::1] ux, double[::1] uy, double[::1] ox, double[::1] oy, Py_ssize_t[::1] row,
    Py_ssize_t n, double r, double psi, double ratio, double[::1] e, double[::1] q, double[::1] w)
cdef Py_ssize_t keep_clear(
    Py_ssize_t[::1] row, Py_ssize_t n, double[::1] e, double[::1] q, double[::1] w, double low, double high)
cdef Py_ssize_t leave_strays(
    Py_ssize_t[::1] row, Py_ssize_t n, double[::1] e, double[::1] q, double[::1] w, double limit, double least)
cdef void normal_equations(Py_ssize_t n, double[::1] e, double[::1] q, double[::1] w, double[::1] sums)
cdef void parabola(Py_ssize_t n, double[::1] e, double[::1] q, double[::1] w, double[::1] sums)
cdef double determinant(double[::1] sums)
cdef bint singular(double[::1] sums)
cdef double misfit_of(double[::1] sums)
cdef double step_r(double[::1] sums)
cdef double step_psi(double[::1] sums)
cdef double foot_of(
    double[::1] ux, double[::1] uy, double[::1] ox, double[::1] oy, Py_ssize_t i, double r, double psi)
cdef double stiffness(double[::1] sums)
cdef double curvature(double[::1] sums)
cdef double bend(double[::1] sums)
cdef bint is_bent(double[::1] sums, double extent, double variance, double max_bend, double max_bow)
cdef bint is_vague(double[::1] sums, double r, double variance, double max_sigma_psi, double max_swing)
cdef double wrapped(double angle) noexcept
cdef double folded(double angle) noexcept
