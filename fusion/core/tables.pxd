cdef class Belief:
    cdef double[::1] x
    cdef double[:, ::1] P
    cdef Py_ssize_t[::1] kept
    cdef Py_ssize_t n, frame
    cdef bint some

cdef class Scans:
    cdef double[:, ::1] rows, told, joint, sights
    cdef double[::1] shared
    cdef Py_ssize_t[::1] first, when, verdict, landmark
    cdef Py_ssize_t scans, parts

cdef class Walls:
    cdef Py_ssize_t[::1] columns, hits, seen, born, ids
    cdef double[:, ::1] anchors
    cdef double[::1] low, high, fixed
    cdef Py_ssize_t width, places
    cdef bint states

cdef class Rest:
    cdef double[:, ::1] lines, sums
    cdef double[::1] least
    cdef Py_ssize_t[::1] counts, same, best
    cdef double near, share
    cdef Py_ssize_t known, repeated
    cdef public Py_ssize_t scans, taken

cdef class Seat:
    cdef double[::1] told
    cdef Py_ssize_t[::1] which, at
    cdef Py_ssize_t free

cdef class Rules:
    cdef double max_turn, max_offset, sigmas, gate, zone, rival, share, longest, least, well, lone_d2, lone_turn
    cdef double lone_offset, rolled, turned, floor, floor_turn, uneven, uneven_turn, bend, bend_turn
    cdef double double_turn, double_offset, double_apart
    cdef Py_ssize_t unmatched, ambiguous, new, tidy, trial, hits
    cdef bint watched, grows, joint, teaches

cdef class Way:
    cdef bint follows
    cdef Py_ssize_t most
    cdef double origin_x, origin_y, reach
    cdef public double length, x, y, ask_at

cdef class Desk:
    cdef double[:, ::1] raw, seated, wall_rows, H, G, R, V
    cdef double[::1] rows, walls, mount, place, offset, pose, triangle, seen, pairs, shared, y, missing
    cdef double[:, ::1] own_H, own_R, S
    cdef double[::1] located, ray, chain, own_y, e, tie, fix, echo, by, noise, apart, chord
    cdef Py_ssize_t[:, ::1] own_at
    cdef Py_ssize_t[::1] fate, order, at, loose, own_states, follows
    cdef Py_ssize_t singles

cdef class Progress:
    cdef public Py_ssize_t instant, why, scan, number, well
    cdef public double x, y, theta

cdef class Odometer:
    cdef double[::1] t
    cdef double[:, ::1] twist, pose, rolled, silence, matched
    cdef Py_ssize_t readings
    cdef double track, noise
    cdef bint silent, matches, parameters

cdef class Wheels:
    cdef double[:, ::1] u, Q, J
    cdef double[::1] dt, drift
    cdef Py_ssize_t[::1] drifting
    cdef Py_ssize_t drifts, first, states

cdef class Headings:
    cdef Py_ssize_t[::1] when, usable, at
    cdef double[::1] z, r
    cdef double[:, ::1] told
    cdef double gate, refused, unused, offset
    cdef Py_ssize_t states, readings, taken
    cdef public Py_ssize_t due

cdef class Bearings:
    cdef Py_ssize_t[::1] when, first
    cdef double[::1] z, r
    cdef double[:, ::1] told
    cdef double x, y, nearest, gate, margin, refused, ambiguous, unmatched
    cdef Seat seat
    cdef Py_ssize_t readings
    cdef public Py_ssize_t due

cdef class Echoes:
    cdef Py_ssize_t[::1] when, first
    cdef double[::1] z, r
    cdef double[:, ::1] cones, told
    cdef double widen, gate, refused, unmatched
    cdef Py_ssize_t readings
    cdef public Py_ssize_t due

cdef class Fixes:
    cdef Py_ssize_t[::1] when
    cdef double[:, ::1] z, R, told
    cdef double[::1] tie
    cdef double lever_x, lever_y, from_x, from_y, gate, refused
    cdef Py_ssize_t at, readings
    cdef bint known
    cdef public Py_ssize_t due

cdef class Turns:
    cdef Py_ssize_t[::1] when
    cdef double[::1] t, z, piece
    cdef double[:, ::1] told
    cdef double walk, by_scale, bias, rest_begin, rest_end, gate, refused, repeated
    cdef Py_ssize_t at_bias, at_before, readings
    cdef public Py_ssize_t last, due

cdef class Sightings:
    cdef Py_ssize_t[::1] when, first, which, ids, columns
    cdef double[:, ::1] z, R, places, mounts, told, joint, placed
    cdef double offset, depth, sigma_bearing, sigma_range, most, gate, refused
    cdef Py_ssize_t numbers, at_offset, at_depth, readings
    cdef bint made
    cdef public Py_ssize_t due

cdef class Poses:
    cdef Py_ssize_t[::1] when, drifts
    cdef double[:, ::1] z, R, told
    cdef double by_way, turn_by_way, arm, floor, turn_floor, gate, refused
    cdef Py_ssize_t at_kept, readings
    cdef bint in_map
    cdef public Py_ssize_t last, due

cdef class Twists:
    cdef Py_ssize_t[::1] when
    cdef double[::1] piece
    cdef double[:, ::1] z, variance, told
    cdef double by_scale, floor, turn_floor, gate, refused
    cdef Py_ssize_t at_kept, readings
    cdef public Py_ssize_t last, due

cdef class Readings:
    cdef Headings headings
    cdef Bearings bearings
    cdef Echoes echoes
    cdef Fixes fixes
    cdef Turns turns
    cdef Sightings sightings
    cdef Poses poses
    cdef Twists twists
    cdef bint whole

cdef class Window:
    cdef unsigned char[:, ::1] excess, red
    cdef unsigned char[::1] least
    cdef int[:, ::1] points
    cdef double[::1] theta, radius, level
    cdef Py_ssize_t[::1] edge, order, room, rings
    cdef Py_ssize_t height, width, left, top, across, down
    cdef double x_c, y_c, fewest, gap
    cdef bint cut

cdef class Notes:
    cdef double[::1] room
    cdef double[:, ::1] pose, triangle, values
    cdef Py_ssize_t[::1] columns
    cdef Py_ssize_t blocks
