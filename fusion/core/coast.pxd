cdef Py_ssize_t DONE, BEFORE, AFTER

cpdef double coast(
    Belief b, Wheels m, Readings r, Scans s, Walls w, Seat seat, Rules rule, Rest rest, Way way, Desk d,
    Notes notes, Progress progress, Py_ssize_t last)
cdef bint is_due(Py_ssize_t[::1] when, Py_ssize_t due, Py_ssize_t readings, Py_ssize_t k)
cdef void keep(Belief b, Readings r, Py_ssize_t k, Desk d)
cdef void roll(Belief b, Wheels m, Progress progress, Py_ssize_t k)
cdef double compare(Belief b, Readings r, Walls w, Desk d, Py_ssize_t k)
cdef double turn(Belief b, Headings h, Py_ssize_t i, Desk d)
cdef double correct_by(
    Belief b, Scans s, Py_ssize_t scan, Py_ssize_t accepted, Headings h, bint whole, Seat seat, Rules rule, Desk d)
cdef void add_heading(Headings h, Py_ssize_t i, Desk d, Py_ssize_t m, Py_ssize_t width)
cdef void correct_in_frame(Belief b, double[:, ::1] V, double[::1] e, Py_ssize_t m)
cpdef void note(
    double[::1] x, double[:, ::1] P, Py_ssize_t frame, double[::1] room, Py_ssize_t k, double[:, ::1] pose,
    double[:, ::1] triangle, Py_ssize_t[::1] columns, Py_ssize_t blocks, double[:, ::1] values)
