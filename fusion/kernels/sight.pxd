cimport cython
from libc.math cimport cos, log, pi, sin, sqrt
from .ekf cimport State
from .places cimport into_base, moved, shares_into_base, wrapped

cdef double MAX_PAIR_ANGLE_RAD, MAX_PAIR_OFFSET_M, PAIR_SIGMAS, FACE_SIGMAS, MAX_ANGLE_RAD, NOWHERE_M
cdef double RIVAL_SCORE, NEAR_D2, MIN_OVERLAP_SHARE, MAX_LENGTH_M, COMMON_M, LONE_D2, LONE_TURN_RAD, LONE_OFFSET_M, RESERVE_FACTOR

cdef enum:
    R_LINE, PSI_LINE, R00_LINE, R01_LINE, R11_LINE, BEGIN_LINE, END_LINE

cdef enum:
    RHO, BETA, ANCHOR_X, ANCHOR_Y, P_RR, P_RB, P_BB, X_RHO, X_BETA, Y_RHO, Y_BETA, T_RHO, T_BETA, WALL

cdef enum:
    LINE_OF, WALL_OF, OFFSET, TURN, R00, R01, R11, S00, S01, S11
    D2, SCORE, BEGIN, END, OVERLAP, COS, SIN, LEVER, PSI, PAIR

cdef class WallColumns:
    cdef Py_ssize_t[::1] columns, hits, seen, born, ids
    cdef double[:, ::1] anchors, fixed
    cdef double[::1] low, high
    cdef readonly Py_ssize_t places
    cdef readonly bint states

cdef class MountStates:
    cdef double[::1] configured
    cdef Py_ssize_t[::1] which, columns
    cdef readonly Py_ssize_t free

cdef class Rules:
    cdef double gate
    cdef bint states, grows
    cdef Py_ssize_t unmatched, ambiguous, new

cdef class AuditColumns:
    cdef int[::1] instant, row
    cdef long long[::1] landmark
    cdef signed char[::1] verdict
    cdef double[::1] nis, threshold
    cdef double[:, ::1] y, sigma

cdef class SightLines:
    cdef readonly Rules rules
    cdef readonly MountStates mount_states
    cdef readonly WallColumns walls
    cdef readonly double[:, ::1] rows, pairs
    cdef readonly double[::1] offset
    cdef readonly Py_ssize_t[::1] match, best, rival, near
    cdef double[:, ::1] wall_rows, seen, mount, G
    cdef double[:, :, ::1] shared
    cdef double[::1] place
    cdef Py_ssize_t[::1] order
    cdef Py_ssize_t room_lines, room_walls
    cdef public Py_ssize_t row
    cdef readonly Py_ssize_t lines, accepted, numbers, found, first, parts

    @cython.locals(n=Py_ssize_t, walls=Py_ssize_t)
    cdef object make_room(self, Py_ssize_t lines, Py_ssize_t places, Py_ssize_t parts)
    cpdef double look(self, State state, WallColumns walls, double[:, ::1] rows, double[:, :, ::1] shared)
    cdef void put_in_base(self, State state, double[:, ::1] rows, double[:, :, ::1] shared)
    cdef void gather(self, State state)
    cdef void predict(self, double x, double y, double theta)
    cdef Py_ssize_t find_pairs(self, State state)
    cdef void spread(self, State state, Py_ssize_t p, Py_ssize_t i, Py_ssize_t j, double side)
    cdef void spread_mount(self, Py_ssize_t p, Py_ssize_t j)
    cdef double lever(self, Py_ssize_t a, double c, double s)
    cdef bint fits(self, Py_ssize_t p, double distance, double limit)
    cdef void extent(self, Py_ssize_t p, Py_ssize_t i, Py_ssize_t j, double side, double x, double y)
    @cython.locals(i=Py_ssize_t, p=Py_ssize_t, m=Py_ssize_t, near=bint)
    cdef void associate(self)
    cdef void try_pair(self, Py_ssize_t p, Py_ssize_t i)
    cdef void claim(self)
    cdef bint overlap(self, Py_ssize_t p, Py_ssize_t q)
    cdef bint fits_well(self, Py_ssize_t p, Py_ssize_t i)
    @cython.locals(i=Py_ssize_t, total=double, matched=double, length=double)
    cpdef double share(self)
    cpdef Py_ssize_t matches(self)
    cpdef void refuse_alone(self)
    cpdef bint is_new(self, Py_ssize_t i)
    cpdef Py_ssize_t state_rows(self, State state) except? -1
    @cython.locals(mount_states=MountStates, a=Py_ssize_t, b=Py_ssize_t, v=Py_ssize_t, w=Py_ssize_t, j=Py_ssize_t, rho=Py_ssize_t, c_psi=double, s_psi=double)
    cdef void state_line(self, State state, Py_ssize_t i, Py_ssize_t p)
    cdef void share_noise(self, State state, Py_ssize_t i, Py_ssize_t p, Py_ssize_t a)
    @cython.locals(rules=Rules, nan=double, i=Py_ssize_t, j=Py_ssize_t, k=Py_ssize_t, p=Py_ssize_t)
    cpdef void write(self, AuditColumns out, Py_ssize_t at, Py_ssize_t instant)
    @cython.locals(walls=WallColumns, i=Py_ssize_t, j=Py_ssize_t, p=Py_ssize_t)
    cpdef void extend(self, Py_ssize_t scan)
