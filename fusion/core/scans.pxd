cdef Py_ssize_t MATCHED, REPEATED, NOTHING, HARDLY, AT_REST

@cython.locals(drives=cython.bint)
cdef Py_ssize_t look(
    Belief b, Scans s, Py_ssize_t i, Walls w, Seat seat, Rules rule, Rest rest, Progress progress, Desk d)
cdef void put_in_base(Belief b, Scans s, Py_ssize_t i, Seat seat, Desk d)
cdef Py_ssize_t find(Belief b, Walls w, Seat seat, Rules rule, Py_ssize_t lines, Desk d)
cdef Py_ssize_t state(Belief b, Scans s, Py_ssize_t i, Walls w, Seat seat, Rules rule, Desk d)
cdef Py_ssize_t columns_of(Py_ssize_t accepted, Seat seat, Rules rule)
cdef bint teach(
    Belief b, Scans s, Py_ssize_t i, Walls w, Rules rule, Rest rest, Way way, Progress progress, Desk d)
cdef bint untidy(double[::1] x, Walls w, Rules rule, Py_ssize_t scan, Desk d)
cdef Py_ssize_t new_lines(Py_ssize_t[::1] fate, Py_ssize_t lines)
cdef void loosen(double[:, ::1] P, Py_ssize_t[::1] columns, double[::1] variance, Py_ssize_t k)
cdef bint goes_far(Belief b, Walls w, Way way)
