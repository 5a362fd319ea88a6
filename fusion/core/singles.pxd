cdef Py_ssize_t WIDE, JUDGED

cdef Py_ssize_t derive(Belief b, bint local, double by_x, double by_y, double by_theta, Py_ssize_t k, Desk d)
@cython.locals(total=cython.double)
cdef double product(double[:, ::1] P, Desk d, Py_ssize_t i, Py_ssize_t j, Py_ssize_t states)
cdef double variance(double[:, ::1] P, Desk d, Py_ssize_t k, Py_ssize_t states)
cdef void state_of(Desk d, Py_ssize_t k, Py_ssize_t j, Py_ssize_t at, double by)
cdef void say(Desk d, Py_ssize_t k, double y, double r, double shared, Py_ssize_t follows)
cdef void say_third(Desk d, Py_ssize_t k, double y, double r, double shared, double first)
@cython.locals(total=cython.double, nis=cython.double)
cdef double weigh(Belief b, Desk d, Py_ssize_t numbers, Py_ssize_t states, double[:, ::1] told, Py_ssize_t row)
cdef void settle(
    Desk d, Py_ssize_t numbers, Py_ssize_t states, double[:, ::1] told, Py_ssize_t row, double landmark, double gate,
    double refused)
cdef void wait(Desk d, Py_ssize_t numbers, Py_ssize_t states)
cdef Py_ssize_t add_singles(Desk d, Py_ssize_t first, Py_ssize_t last, Py_ssize_t m, Py_ssize_t width)
cdef void make_room(Desk d, Py_ssize_t m, Py_ssize_t width, Py_ssize_t states)
cdef double fit_of(Belief b, Desk d, Py_ssize_t first, Py_ssize_t last, double[:, ::1] joint, Py_ssize_t i)
cdef void note_fit(double[:, ::1] joint, Py_ssize_t i, double[::1] e, Py_ssize_t m)
