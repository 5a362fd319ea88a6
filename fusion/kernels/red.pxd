from libc.math cimport atan2, floor, pi, sqrt

cdef Py_ssize_t MIN_RED_NEIGHBOURS
cdef double MAX_GAP_PX

cdef class Window:
    cdef unsigned char[:, ::1] excess, red
    cdef unsigned char[::1] least
    cdef Py_ssize_t left, top

cdef class Circle:
    cdef double x, y, outer
    cdef Py_ssize_t across, down
    cdef bint cut

cdef class Pixels:
    cdef Py_ssize_t count
    cdef double fewest
    cdef double[::1] theta, radius, level
    cdef Py_ssize_t[::1] edge, order, chosen, rings

cpdef Py_ssize_t find_things(Window window, Circle circle, int[:, ::1] points, Pixels pixels, double[:, ::1] out)
cdef void find_red(Window window, Circle circle, int[:, ::1] points, Pixels pixels)
cdef Py_ssize_t red_neighbours(Window window, Py_ssize_t x, Py_ssize_t y)
cdef void sort(double[::1] values, Py_ssize_t n, Py_ssize_t[::1] order, Py_ssize_t[::1] room)
cdef void merge_runs(
    double[::1] values, Py_ssize_t begin, Py_ssize_t middle, Py_ssize_t end, Py_ssize_t[::1] order,
    Py_ssize_t[::1] room)
cdef bint together(Pixels pixels, Py_ssize_t a, Py_ssize_t b, double turn)
cdef bint measure(
    Pixels pixels, Circle circle, Py_ssize_t begin, Py_ssize_t count, double[:, ::1] out, Py_ssize_t k)
cdef Py_ssize_t choose_whole_circles(Pixels pixels, bint cut, Py_ssize_t begin, Py_ssize_t count)
cdef double circles(Pixels pixels, Py_ssize_t count, double near, double far)
cdef Py_ssize_t ring(double near, double radius)
cdef double middle_of(Pixels pixels, Py_ssize_t count)
