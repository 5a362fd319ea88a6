cimport cython
from libc.math cimport cos, sin, sqrt

from .places cimport wrapped
from .segments cimport Limits, Returns, ScanColumns, Segments, distance, find_walls, head_of, tail_of

cdef double FAR_FOOT_M, MAX_PSI_RAD, MIN_CURVE_TURN_RAD, MAX_JOINT_TURN_RAD, MAX_SHADOW_M
cdef double MIN_CURVE_GAIN_CHI2, SPARED_PIECE_CHI2, MIN_PIECE_GAIN_CHI2
cdef Py_ssize_t MIN_CURVE_PIECES

cdef class Fit:
    cdef Py_ssize_t[::1] row
    cdef double[::1] error, foot, weight
    cdef Py_ssize_t count
    cdef double r, psi, sum_w, sum_wq, sum_wqq, sum_we, sum_wqe, sum_wee, sum_wqqq, sum_wqqqq, sum_wqqe
    cdef double det, step_r, step_psi, rest

cdef class Curves:
    cdef double[::1] joint, gains
    cdef Py_ssize_t[::1] curved
    cdef double saved, pieces

cdef class Sweep:
    cdef double[:, ::1] share
    cdef Py_ssize_t pieces
    cdef double lever_x, lever_y, ahead_x, ahead_y

cdef class FoundLines:
    cdef readonly Py_ssize_t[::1] counts, curved, points
    cdef readonly Py_ssize_t[:, ::1] span
    cdef readonly double[:, ::1] z, R, ends
    cdef readonly double[::1] chi2
    cdef readonly double[:, :, ::1] sweep
    cdef readonly Py_ssize_t count

cpdef FoundLines find_lines(ScanColumns scans, Limits limits, Sweep sweep)
cdef bint fit_wall(Returns returns, Limits limits, Segments segments, Py_ssize_t wall, Fit fit, FoundLines found)
cdef bint finish(Returns returns, Limits limits, Fit fit, FoundLines found)
@cython.locals(s=double, sq=double, sqq=double)
cdef void loadings(Returns returns, Fit fit, Sweep sweep, FoundLines found)
cdef void rows_of(Segments segments, Py_ssize_t wall, Fit fit)
cdef void residuals(Returns returns, Limits limits, Fit fit)
cdef void keep(Fit fit, Py_ssize_t k, Py_ssize_t kept)
cdef void leave_strays(Fit fit, double limit, double least)
cdef bint solve(Fit fit)
cdef void parabola(Fit fit)
cdef double foot_of(Returns returns, Py_ssize_t i, double r, double psi)
cdef double stiffness(Fit fit)
cdef double curvature(Fit fit)
cdef void find_curves(Returns returns, Limits limits, Segments segments, Fit fit, Curves curves)
cdef Py_ssize_t joints(Returns returns, Segments segments, Curves curves)
cdef double curvature_of(Curves curves, Py_ssize_t walls, bint closed, Py_ssize_t i)
cdef double gain(Returns returns, Limits limits, Segments segments, Py_ssize_t wall, Fit fit, double bent)
cdef void goes_on(Curves curves, Py_ssize_t walls, Py_ssize_t i, Py_ssize_t step)
cdef bint is_piece(Curves curves, Py_ssize_t walls, bint closed, Py_ssize_t i, double length)
