cimport cython
from libc.math cimport atan2, cos, pi, sin, sqrt, tan

cdef double JOINS_NEVER_CHI2, GAP_SCORE_M, MAX_CORNER_SHARE, MIN_CORNER_SINE, FAR_M, MIN_DIVISOR
cdef Py_ssize_t MAX_STRAY_BEAMS, MAX_CORNER_BEAMS

cdef class ScanColumns:
    cdef double[:, ::1] ranges, cosine, sine, x, y
    cdef double[::1] growth
    cdef Py_ssize_t[::1] ring
    cdef double low, high
    cdef bint moving

cdef class Limits:
    cdef double sigma_range, sigma_angle, ratio, variance, min_points, min_length, max_gap, bridge
    cdef double split_sigmas, split_floor, flatness, merge_chi2, grazing, stray_sigmas, corner_sigmas
    cdef double max_sigma_psi, max_swing, max_chi2, max_bow, max_bend

cdef class Returns:
    cdef double[::1] ranges, tolerance, ux, uy, ox, oy, x, y
    cdef Py_ssize_t[::1] beam
    cdef Py_ssize_t count
    cdef bint closed

cdef class Segments:
    cdef Py_ssize_t[::1] run_first, first, linked, after, before, best, bounds, start, stop
    cdef Py_ssize_t[:, ::1] todo
    cdef double[:, ::1] moments
    cdef double[::1] own, cost, r, psi, low, high
    cdef Py_ssize_t runs, pieces, groups, parts, walls

cdef void find_walls(ScanColumns scans, Py_ssize_t scan, Limits limits, Returns returns, Segments segments)
cdef void gather(ScanColumns scans, Py_ssize_t scan, Py_ssize_t begin, Returns returns)
cdef double gap(Returns returns, Py_ssize_t before, Py_ssize_t i, double growth, double max_gap)
cdef Py_ssize_t ring_start(Returns returns, double growth, double max_gap)
cdef void cut_at_gaps(Returns returns, double growth, double max_gap, Segments segments)
cdef void allow(Returns returns, Limits limits)
cdef Py_ssize_t farthest(Returns returns, Py_ssize_t begin, Py_ssize_t end)
cdef void split(Returns returns, Segments segments)
cdef void weigh(Returns returns, Limits limits, Segments segments)
cdef double misfit(double w, double sx, double sy, double sxx, double sxy, double syy)
cdef double joint_misfit(Segments segments, Py_ssize_t i, Py_ssize_t j)
cdef double own_misfit(Segments segments, Py_ssize_t i)
cdef void join(Segments segments, Py_ssize_t i, Py_ssize_t j)
cdef Py_ssize_t merge(Segments segments, Py_ssize_t count, double limit)
cdef Py_ssize_t cheapest(Segments segments, Py_ssize_t count, double limit)
cdef void join_pairs(Segments segments, Py_ssize_t chosen)
cdef void renew_cost(Segments segments, Py_ssize_t i)
cdef Py_ssize_t compact(Segments segments, Py_ssize_t count)
cdef double distance(Returns returns, Py_ssize_t i, Py_ssize_t j)
cdef Py_ssize_t head_of(Segments segments, Py_ssize_t wall)
cdef Py_ssize_t tail_of(Segments segments, Py_ssize_t wall)
cdef void long_enough(Returns returns, Limits limits, Segments segments)
cdef bint near(Returns returns, Limits limits, Py_ssize_t head, Py_ssize_t tail, Py_ssize_t next_head, Py_ssize_t next_tail, Py_ssize_t between)
cdef void close_ring(Returns returns, Limits limits, Segments segments)
cdef void rotate(Py_ssize_t[::1] values, Py_ssize_t count, Py_ssize_t by, Py_ssize_t[::1] room)
cdef void perpendicular_fit(Segments segments)
cdef void corner_limits(Returns returns, Limits limits, Segments segments)
cdef void limit_by_corner(Returns returns, Segments segments, Py_ssize_t wall, Py_ssize_t end, Py_ssize_t other, double corner, double margin)
cdef double along(Returns returns, Py_ssize_t i, double psi)
