cpdef double surplus(double turned, double dt, double bias, double theta, double before)
cpdef double turn_noise(double walk, double dt, double by_scale, double turned)
cdef double turned(Belief b, Turns g, Py_ssize_t i, Desk d)
cdef void begin_turn(Belief b, Turns g, Py_ssize_t i)
