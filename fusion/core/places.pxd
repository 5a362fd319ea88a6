@cython.locals(psi=cython.double, r=cython.double, cross=cython.double, begin=cython.double, end=cython.double)
cpdef void into_base(double[:, ::1] rows, Py_ssize_t lines, double x, double y, double yaw, double[:, ::1] out)
cpdef void moved(double[::1] place, double[::1] told, double[::1] out)
cpdef void shares_into_base(
    double[:, ::1] rows, Py_ssize_t lines, Py_ssize_t parts, double x, double y, double yaw, double[::1] shared,
    Py_ssize_t first, double[::1] out)
cdef Py_ssize_t KNOWN
cpdef void behind(
    double[:, ::1] rows, Py_ssize_t lines, Py_ssize_t samples, double[:, ::1] walls, Py_ssize_t m, double x, double y,
    double theta, bint both, double near, double margin, double grazing, double[:, ::1] normal, double[::1] out)
cdef void normals(double[:, ::1] walls, Py_ssize_t m, double[:, ::1] normal)
cdef bint blocked(
    double[:, ::1] walls, Py_ssize_t m, double[:, ::1] normal, double x, double y, double dx, double dy,
    double reach, bint both, double margin, double grazing)
@cython.locals(total=cython.double, possible=cython.double, share=cython.double)
cpdef void explained(
    double[:, ::1] poses, Py_ssize_t h, double[:, ::1] rows, Py_ssize_t lines, double[:, ::1] walls, Py_ssize_t m,
    double angle, double offset, double overlap, double[:, ::1] normal, double[:, ::1] out)
cdef Py_ssize_t likeness(
    double[:, ::1] poses, Py_ssize_t p, double[:, ::1] rows, Py_ssize_t i, double[:, ::1] walls, Py_ssize_t m,
    double angle, double offset, double least, double[:, ::1] normal)
cpdef Py_ssize_t hypotheses(
    double[:, ::1] rows, Py_ssize_t a, Py_ssize_t b, double[:, ::1] walls, Py_ssize_t m, double parallel,
    double[:, ::1] normal, Py_ssize_t found, double[:, ::1] poses)
cdef double against(double[:, ::1] walls, Py_ssize_t j, double[:, ::1] normal)
