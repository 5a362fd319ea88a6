cdef Py_ssize_t MEASURED, NINE

cpdef Py_ssize_t things(Window g, Py_ssize_t n, double[:, ::1] out)
cdef Py_ssize_t red_pixels(Window g, Py_ssize_t n)
cdef Py_ssize_t on_edge(Py_ssize_t x, Py_ssize_t y, Py_ssize_t across, Py_ssize_t down)
cdef Py_ssize_t reds(Window g, Py_ssize_t j, Py_ssize_t i)
cdef void sort(double[::1] values, Py_ssize_t n, Py_ssize_t[::1] order, Py_ssize_t[::1] room)
cdef void merge_runs(
    double[::1] values, Py_ssize_t begin, Py_ssize_t middle, Py_ssize_t end, Py_ssize_t[::1] order,
    Py_ssize_t[::1] room)
cdef bint together(Window g, Py_ssize_t a, Py_ssize_t b, double turn)
cdef bint measure(Window g, Py_ssize_t begin, Py_ssize_t count, Py_ssize_t n, double[:, ::1] out, Py_ssize_t k)
cdef Py_ssize_t whole_circles(Window g, Py_ssize_t begin, Py_ssize_t count, Py_ssize_t n)
cdef double circles(Window g, Py_ssize_t pixels, double near, double far)
cdef Py_ssize_t ring(double near, double radius)
cdef double middle_of(Window g, Py_ssize_t pixels)
