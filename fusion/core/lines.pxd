cimport cython

cdef double MAX_TURN, MIN_RATIO

@cython.locals(
    d=double[::1], ux=double[::1], uy=double[::1], ox=double[::1], oy=double[::1], x=double[::1], y=double[::1],
    tolerance=double[::1], e=double[::1], q=double[::1], w=double[::1], sums=double[::1], m=double[::1],
    own=double[::1], cost=double[::1], r=double[::1], psi=double[::1], near_end=double[::1], far_end=double[::1],
    beam=Py_ssize_t[::1], row=Py_ssize_t[::1], run_first=Py_ssize_t[::1], first=Py_ssize_t[::1],
    todo=Py_ssize_t[::1], linked=Py_ssize_t[::1], after=Py_ssize_t[::1], before=Py_ssize_t[::1],
    best=Py_ssize_t[::1], groups=Py_ssize_t[::1], start=Py_ssize_t[::1], stop=Py_ssize_t[::1],
    bounds=Py_ssize_t[::1], curved=Py_ssize_t[::1], joint=double[::1], gains=double[::1], ratio=double,
    variance=double, closed=cython.bint)
cpdef Py_ssize_t extract(
    object floats, object wholes, Py_ssize_t scans, Py_ssize_t beams, double[::1] ranges, double[::1] cos_,
    double[::1] sin_, double[::1] x0, double[::1] y0, Py_ssize_t stride, double[::1] growth, Py_ssize_t[::1] ring,
    double low, double high, double[::1] settings, double[::1] share, Py_ssize_t slips, Py_ssize_t[::1] counts,
    Py_ssize_t[::1] hidden, double[::1] out, double[::1] loads) except? -1  # floats and wholes may lack memory
cdef Py_ssize_t fit(
    double[::1] d, double[::1] ux, double[::1] uy, double[::1] ox, double[::1] oy, Py_ssize_t[::1] row,
    Py_ssize_t n, double begin, double end, double[::1] e, double[::1] q, double[::1] w, double[::1] sums, double r,
    double psi, double[::1] settings, double[::1] out, Py_ssize_t line)
cdef bint finish(
    double[::1] ux, double[::1] uy, double[::1] ox, double[::1] oy, Py_ssize_t[::1] row, Py_ssize_t n,
    double[::1] sums, double r, double psi, double[::1] settings, double[::1] out, Py_ssize_t line)
cdef void loadings(
    Py_ssize_t[::1] row, Py_ssize_t n, Py_ssize_t[::1] beam, Py_ssize_t beams, double[::1] q, double[::1] w,
    double[::1] sums, double psi, double[::1] motion, double[::1] share, Py_ssize_t slips, double[::1] loads,
    Py_ssize_t line)
