cdef Py_ssize_t LINE, TOLD

cdef double COMMON
@cython.locals(near=cython.bint)
cpdef void match(
    double[::1] pairs, Py_ssize_t found, double[::1] rows, Py_ssize_t lines, double gate, double zone, double rival,
    double share, double longest, Py_ssize_t[::1] fate, Py_ssize_t[::1] order)
cdef void claim(double[::1] pairs, Py_ssize_t lines, Py_ssize_t[::1] fate, Py_ssize_t[::1] order)
cdef bint overlap(double[::1] pairs, Py_ssize_t a, Py_ssize_t b)
cdef bint fits_well(
    double[::1] pairs, Py_ssize_t at, double[::1] rows, Py_ssize_t i, double gate, double share, double longest)
cdef Py_ssize_t whole(double number)
cpdef double matched_share(double[::1] rows, Py_ssize_t lines, Py_ssize_t[::1] fate)
cpdef Py_ssize_t judge(
    double[::1] pairs, Py_ssize_t[::1] fate, Py_ssize_t lines, Py_ssize_t[::1] ids, Py_ssize_t unmatched,
    Py_ssize_t ambiguous, Py_ssize_t new, Py_ssize_t first, Py_ssize_t[::1] verdicts, Py_ssize_t[::1] landmarks, double[:, ::1] told)
cpdef void equation(
    double[::1] pairs, Py_ssize_t[::1] fate, Py_ssize_t row, Py_ssize_t lines, Py_ssize_t[::1] columns, bint states,
    double[::1] mount, Py_ssize_t free, Py_ssize_t[::1] at_mount, double[::1] rows, double[::1] shared,
    Py_ssize_t parts, Py_ssize_t[::1] at, double[:, ::1] H, double[:, ::1] G, double[:, ::1] R, double[::1] y)
cdef void share(
    double[::1] pairs, Py_ssize_t of, double[::1] rows, Py_ssize_t i, double[::1] shared, Py_ssize_t parts,
    double[:, ::1] G, Py_ssize_t a, double[:, ::1] R)
cpdef void extend(
    double[::1] pairs, Py_ssize_t[::1] fate, Py_ssize_t lines, double[::1] low, double[::1] high,
    Py_ssize_t[::1] hits, Py_ssize_t[::1] seen, Py_ssize_t scan)
cpdef Py_ssize_t lacks(
    double[:, ::1] P, Py_ssize_t[::1] columns, Py_ssize_t places, double rho, double beta, Py_ssize_t[::1] at,
    double[::1] missing)
cpdef void refuse_alone(
    double[::1] pairs, Py_ssize_t lines, Py_ssize_t[::1] fate, double d2, double turn, double offset)
cpdef bint is_new(Py_ssize_t[::1] fate, Py_ssize_t lines, Py_ssize_t i)
cpdef Py_ssize_t bends(
    double[:, ::1] P, double[::1] pairs, Py_ssize_t[::1] fate, Py_ssize_t lines, Py_ssize_t[::1] columns, double rho,
    double beta, double most_rho, double most_beta, Py_ssize_t[::1] at, double[::1] missing)
