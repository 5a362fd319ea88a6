cdef double OVERHANG, CLEAR, CLUTTER, SQUARE, FAR
cdef Py_ssize_t ECHO

@cython.locals(on_it=cython.bint)
cpdef Py_ssize_t answering(
    double[::1] x, Walls w, double px, double py, double theta, double lever_x, double lever_y, double yaw, double half,
    double widen, double sigma, double[::1] out)
cdef double rho_of(double[::1] x, Walls w, Py_ssize_t j)
cdef double beta_of(double[::1] x, Walls w, Py_ssize_t j)
cdef double slanted(Walls w, Py_ssize_t j, double distance, double foot, double off, double half)
cpdef double likelier(double distance, double sigma)
cdef double hear(Belief b, Walls w, Echoes e, Py_ssize_t i, Desk d)
