cdef Py_ssize_t CHORD

cpdef void chord(double[::1] d, double[::1] out)
cpdef double straight(double way, double turn)
cpdef double sum_noise(double variance, double by_scale, double value, double floor)
cdef double driven(Belief b, Twists w, Py_ssize_t i, Desk d)
cdef void begin_way(Belief b, Twists w, Py_ssize_t i)
