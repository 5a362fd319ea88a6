cpdef void into_base(double[:, ::1] rows, Py_ssize_t lines, double x, double y, double yaw, double[:, ::1] out)
