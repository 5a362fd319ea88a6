cimport cython
from libc.math cimport cos, exp, sin, sqrt

cdef Py_ssize_t ACCEPTED, GATE, MAX_NUMBERS
cdef double MIN_KEPT_SHARE, NAN, INFINITE

cdef class Steps:
    cdef double[:, ::1] u, Q, J
    cdef double[::1] dt
    cpdef of(self, Py_ssize_t k)
    cpdef noise_of(self, Py_ssize_t k)
    cpdef double dt_of(self, Py_ssize_t k)

cdef class TrackColumns:
    cdef double[:, ::1] pose, triangle, values
    cdef Py_ssize_t[::1] states

cdef class Innovation:
    cdef public Py_ssize_t row, verdict, landmark, first, numbers
    cdef public double nis, threshold
    cdef public object y, sigma

cdef class State:
    cdef double[::1] mean
    cdef double[:, ::1] P, row_H, row_R, V, S, small
    cdef double[::1] row_y, e, drift_by
    cdef Py_ssize_t[:, ::1] row_at
    cdef Py_ssize_t[::1] row_count, queued_rows, kept, drift_at
    cdef public Py_ssize_t n, frame, wheels, written, queued
    cdef Py_ssize_t drifting
    cdef public bint keeps
    cdef public double frame_x, frame_y

    @cython.locals(n=Py_ssize_t, i=Py_ssize_t, j=Py_ssize_t, states=Py_ssize_t, at=Py_ssize_t, by=double, ux=double, uy=double, turn=double, dx=double, dy=double)
    cpdef void move(self, Steps steps, Py_ssize_t k)
    @cython.locals(d=Py_ssize_t, states=Py_ssize_t, first=Py_ssize_t, a=Py_ssize_t, j=Py_ssize_t, found=Innovation)
    cpdef Innovation compare(
        self, Py_ssize_t row, object y, object H, object R, double threshold, object columns=*, object H_block=*,
        bint in_map=*)
    @cython.locals(w=Py_ssize_t, j=Py_ssize_t, by_x=double, by_y=double, by_theta=double)
    cdef object write_row(self, Py_ssize_t k, object H, object columns, object H_block, bint in_map)
    cdef object room_for(self, Py_ssize_t rows, Py_ssize_t columns)
    cdef Py_ssize_t put(self, Py_ssize_t k, Py_ssize_t w, Py_ssize_t column, double h)
    cdef Py_ssize_t derive(self, Py_ssize_t k, double by_x, double by_y, double by_theta, bint in_map)
    cdef Py_ssize_t derive_frame(self, Py_ssize_t k, Py_ssize_t w, double by_x, double by_y, double by_theta)
    @cython.locals(total=double, v=double, i=Py_ssize_t, j=Py_ssize_t, at=Py_ssize_t)
    cdef double covariance_of(self, Py_ssize_t a, Py_ssize_t b)
    @cython.locals(total=double, nis=double, greatest=double, share=double, v=double, a=Py_ssize_t, b=Py_ssize_t, i=Py_ssize_t, j=Py_ssize_t, k=Py_ssize_t)
    cdef double judge(self, Py_ssize_t first, Py_ssize_t d) except? -1.0
    cpdef double variance(self, object H, object columns=*, object H_block=*, bint in_map=*) except? -1.0
    cpdef void begin(self)
    cpdef void queue_rows(self, Py_ssize_t first, Py_ssize_t rows)
    cpdef void add_row_noise(self, Py_ssize_t k, double variance)
    cpdef double whiten(self, Py_ssize_t begin, Py_ssize_t end)
    @cython.locals(n=Py_ssize_t, i=Py_ssize_t, j=Py_ssize_t, k=Py_ssize_t, q=Py_ssize_t, r=Py_ssize_t, row=Py_ssize_t, greatest=double, h=double)
    cdef double project(self, Py_ssize_t begin, Py_ssize_t m)
    cdef bint factor(self, Py_ssize_t m)
    cpdef object correct_queued(self)
    cdef void correct_all(self, Py_ssize_t m)
    cdef void correct_some(self, Py_ssize_t m)
    cdef void mirror(self, Py_ssize_t i, Py_ssize_t first, double least)
    cpdef double fit(self, Py_ssize_t rows)
    cpdef void turn_frame(self, double dx, double dy)
    cpdef void copy_pose(self, Py_ssize_t column)
    cpdef object replace(self, object columns, object values, object G)
    cdef void turn_rows(self, Py_ssize_t first, Py_ssize_t k)
    cpdef double value(self, Py_ssize_t column)
    cpdef pose(self)
    cpdef pose_in_map(self)
    @cython.locals(first=Py_ssize_t, at=Py_ssize_t, n=Py_ssize_t, G=Py_ssize_t, a=Py_ssize_t, b=Py_ssize_t, j=Py_ssize_t, w=Py_ssize_t, x=double, y=double, theta=double, by_x=double, by_y=double, by_theta=double, e=double, c=double, s=double, rx=double, ry=double)
    cpdef object note(self, Py_ssize_t k, TrackColumns track)

cpdef double bent(double tt)
