cdef double NEVER

cpdef void repeats(double[:, ::1] rows, Py_ssize_t begin, Py_ssize_t lines, Rest rest, Py_ssize_t[::1] same)
@cython.locals(nearest=cython.double)
cdef Py_ssize_t nearest_of(double[:, ::1] rows, Py_ssize_t a, Py_ssize_t i, Rest rest)
cpdef void add_repeated(double[:, ::1] rows, Py_ssize_t begin, Py_ssize_t lines, Rest rest, Py_ssize_t[::1] same)
cpdef bint counts(Py_ssize_t scans)
cdef bint only_repeats(Scans s, Py_ssize_t i, Rest rest)
