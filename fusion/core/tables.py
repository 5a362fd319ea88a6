"""What the core works on: arrays and numbers that belong together, handed over as one.

Each is made once and lasts as long as its arrays do. Nothing here does anything.
"""


class Belief:
    """State x (n,), covariance P (n, n), and the first column of the map frame, -1 without one.

    States that are `kept` (n,) count and are never corrected (Schmidt), if there are `some`.
    """

    def __init__(self, x, P, n, frame, kept, some):
        self.x, self.P, self.n, self.frame = x, P, n, frame
        self.kept, self.some = kept, some


class Scans:
    """Measured lines (k, 7), scan by scan, and what becomes of each.

    Scan i, of so many `scans`, is due at instant when[i]; its lines are first[i] until first[i + 1]. `shared`
    (k, 2, parts), flat, are unit errors that the lines of a scan share. Written are verdict, landmark (k,), told
    (k, 5: NIS, y, sigma), and of each scan joint (NIS of all that is accepted, and its degrees of freedom) and
    sights (the pose before, what `moved` says of the mount, the pose after).
    """

    def __init__(
        self, rows, first, when, scans, shared, parts, verdict, landmark, told, joint, sights
    ):  # fmt: skip
        self.rows, self.first, self.when, self.scans = rows, first, when, scans
        self.shared, self.parts = shared, parts
        self.verdict, self.landmark, self.told, self.joint, self.sights = verdict, landmark, told, joint, sights


class Walls:
    """The line map: `places` lines, as `pairs` and `match` want them; `fixed` those that are no states."""

    def __init__(self, columns, anchors, low, high, hits, seen, born, ids, fixed, width, places, states):
        self.columns, self.anchors, self.low, self.high = columns, anchors, low, high
        self.hits, self.seen, self.born, self.ids = hits, seen, born, ids
        self.fixed, self.width, self.places, self.states = fixed, width, places, states


class Rest:
    """The scans of a robot at rest, so many `scans`; fewer than two where it drives.

    `lines` (known, 4: r, psi, both ends) are those of the first and what others showed beside them, `sums` (known,
    2) by how much `counts` (known,) of them were off since the last that counted. Lines are the same within the
    squared distance `near` where a `share` of the longer is common. `repeated` is the verdict on scans that are
    `taken`. Room: same (lines of a scan,), best and least (known,).
    """

    def __init__(self, lines, sums, counts, known, scans, near, share, repeated, same, best, least, taken):
        self.lines, self.sums, self.counts, self.known, self.scans = lines, sums, counts, known, scans
        self.near, self.share, self.repeated = near, share, repeated
        self.same, self.best, self.least, self.taken = same, best, least, taken


class Seat:
    """The laser's mount as it is configured (3,); of its `free` states which (of x, y, yaw), and their columns."""

    def __init__(self, told, which, at, free):
        self.told, self.which, self.at, self.free = told, which, at, free


class Rules:
    """What decides on pairs, scans and lessons: the constants of fusion.linemap."""

    def __init__(
        self, max_turn, max_offset, sigmas, gate, zone, rival, share, longest, unmatched, ambiguous, new, watched,
        least, well, grows, joint, lone_d2, lone_turn, lone_offset, tidy, trial, hits, double_turn, double_offset,
        double_apart, rolled, turned, floor, floor_turn, uneven, uneven_turn, bend, bend_turn, teaches,
    ):  # fmt: skip
        self.max_turn, self.max_offset, self.sigmas = max_turn, max_offset, sigmas
        self.gate, self.zone, self.rival, self.share, self.longest = gate, zone, rival, share, longest
        self.unmatched, self.ambiguous, self.new = unmatched, ambiguous, new
        self.watched, self.least, self.well = watched, least, well
        self.grows, self.joint, self.teaches = grows, joint, teaches
        self.lone_d2, self.lone_turn, self.lone_offset = lone_d2, lone_turn, lone_offset
        self.tidy, self.trial, self.hits = tidy, trial, hits
        self.double_turn, self.double_offset, self.double_apart = double_turn, double_offset, double_apart
        self.rolled, self.turned = rolled, turned
        self.floor, self.floor_turn = floor, floor_turn
        self.uneven, self.uneven_turn, self.bend, self.bend_turn = uneven, uneven_turn, bend, bend_turn


class Way:
    """The way through a map, if one is followed, and where the loop in Python wants to be asked."""

    def __init__(
        self, follows=False, length=0.0, x=0.0, y=0.0, ask_at=0.0, origin_x=0.0, origin_y=0.0, reach=0.0, most=0,
    ):  # fmt: skip
        self.follows, self.length, self.x, self.y = follows, length, x, y
        self.ask_at, self.origin_x, self.origin_y, self.reach, self.most = ask_at, origin_x, origin_y, reach, most


class Desk:
    """Room for one instant: a scan, its equation (at, H, R, y, V), and the `singles`, rows that wait for it.

    `seated`, `walls` and `shared` lie in memory as their flat twins. What is a single row's begins with `own`.
    """

    def __init__(
        self, raw, seated, rows, wall_rows, walls, mount, place, offset, pose, triangle, seen, pairs, fate, order,
        shared, at, H, G, R, y, V, loose, missing, located, ray, chain, own_at, own_H, own_y, own_R, own_states,
        follows, S, e, tie, fix, echo, by, noise, apart, chord, singles=0,
    ):  # fmt: skip
        self.raw, self.seated, self.rows, self.wall_rows, self.walls = raw, seated, rows, wall_rows, walls
        self.mount, self.place, self.offset, self.pose, self.triangle = mount, place, offset, pose, triangle
        self.seen, self.pairs, self.fate, self.order = seen, pairs, fate, order
        self.shared, self.at, self.H, self.G, self.R, self.y, self.V = shared, at, H, G, R, y, V
        self.loose, self.missing = loose, missing
        self.located, self.ray, self.chain = located, ray, chain
        self.own_at, self.own_H, self.own_y, self.own_R = own_at, own_H, own_y, own_R
        self.own_states, self.follows, self.S, self.e = own_states, follows, S, e
        self.tie, self.fix, self.echo, self.by = tie, fix, echo, by
        self.noise, self.apart, self.chord, self.singles = noise, apart, chord, singles


class Progress:
    """How far a drive has come: the instant that was reached, why the core stopped there, and the next scan.

    x, y [m] and theta [rad] are what the wheels rolled since the last scan that was used; `number` is that of the
    last scan that taught the map, `well` the last one that fitted well.
    """

    def __init__(self, instant, why, scan, x, y, theta, number, well):
        self.instant, self.why, self.scan = instant, why, scan
        self.x, self.y, self.theta, self.number, self.well = x, y, theta, number, well


class Odometer:
    """Wheel readings at t (readings,) [s]: between two of them the twist (3) is constant, from the pose (3) on.

    Either wheel rolled as `rolled` (2) says [m], with the variance `noise` for each metre, on a `track` [m]. Where
    the way is not known (`silent`) the variance of the place [m^2] and the turning rate [rad/s] are `silence` (2),
    and where the motion was matched (`matches`) its covariance is `matched` (9). `parameters`: J is asked for.
    """

    def __init__(
        self, t, twist, pose, rolled, silence, matched, readings, track, noise, silent, matches, parameters
    ):  # fmt: skip
        self.t, self.twist, self.pose, self.rolled = t, twist, pose, rolled
        self.silence, self.matched, self.readings = silence, matched, readings
        self.track, self.noise = track, noise
        self.silent, self.matches, self.parameters = silent, matches, parameters


class Wheels:
    """Motions u (instants, 3), Q (instants, 9), dt (instants,).

    The states `drifting` (drifts,) gain the variance `drift` each second. So many `states`, from column `first`
    on, correct the motions: J (instants, 3 states) is the derivative of u by them.
    """

    def __init__(self, u, Q, dt, drifting, drift, drifts, J, first, states):
        self.u, self.Q, self.dt = u, Q, dt
        self.drifting, self.drift, self.drifts = drifting, drift, drifts
        self.J, self.first, self.states = J, first, states


class Headings:
    """Headings, `readings` of them: i at instant when[i] is z[i] [rad] of variance r[i].

    What is predicted is `offset` and the sum of the states `at` (states,). Where a heading is not `usable`, or
    beyond `gate`, it corrects nothing. Written is told (readings, 6: verdict, landmark, NIS, threshold, y, sigma),
    with the verdict 0, `refused` or `unused`. The next to come is `due`, and `taken` the one of this instant that
    corrects, else -1.
    """

    def __init__(self, when, z, r, usable, gate, refused, unused, offset, at, states, told, readings, due, taken):
        self.when, self.z, self.r, self.usable = when, z, r, usable
        self.gate, self.refused, self.unused, self.offset = gate, refused, unused, offset
        self.at, self.states, self.told, self.readings = at, states, told, readings
        self.due, self.taken = due, taken


class Bearings:
    """Bearings of the point (x, y) [m, map frame], seen in `readings` pictures: i at instant when[i].

    Its candidates, first[i] until first[i + 1], are z [rad] of variance r. Written is told (k, 6: verdict,
    landmark, NIS, threshold, y, sigma); `gate` to `unmatched` are those of `bearings.choose`. The camera sits as
    `seat` says, and nearer than `nearest` [m] it is inside the point. The next to come is picture `due`.
    """

    def __init__(
        self, when, first, z, r, told, x, y, nearest, gate, margin, refused, ambiguous, unmatched, seat, readings,
        due,
    ):  # fmt: skip
        self.when, self.first, self.z, self.r, self.told = when, first, z, r, told
        self.x, self.y, self.nearest, self.gate, self.margin = x, y, nearest, gate, margin
        self.refused, self.ambiguous, self.unmatched = refused, ambiguous, unmatched
        self.seat, self.readings, self.due = seat, readings, due


class Echoes:
    """Echoes z [m] of variance r: reading i, at instant when[i], has row first[i] unless that is first[i + 1].

    cones (k, 4) are x, y [m] and yaw of a sonar on the base, and how far it hears to either side [rad]; walls
    count up to `widen` [rad] beyond. Written is told (k, 6: verdict, landmark, NIS, threshold, y, sigma).
    """

    def __init__(self, when, first, z, r, cones, widen, told, gate, refused, unmatched, readings, due):
        self.when, self.first, self.z, self.r, self.cones = when, first, z, r, cones
        self.widen, self.told = widen, told
        self.gate, self.refused, self.unmatched = gate, refused, unmatched
        self.readings, self.due = readings, due


class Fixes:
    """Fixes z (k, 2) [m], of covariance R (k, 3: ee, en, nn), at instants `when` (k,): see `fixes.fix`.

    The tie is that of four states from column `at` on, or `tie` where that is -1. Written is told (k, 8: verdict,
    landmark, NIS, threshold, y, y, sigma, sigma).
    """

    def __init__(
        self, when, z, R, told, lever_x, lever_y, from_x, from_y, tie, at, known, gate, refused, readings, due
    ):  # fmt: skip
        self.when, self.z, self.R, self.told = when, z, R, told
        self.lever_x, self.lever_y, self.from_x, self.from_y = lever_x, lever_y, from_x, from_y
        self.tie, self.at, self.known = tie, at, known
        self.gate, self.refused = gate, refused
        self.readings, self.due = readings, due


class Turns:
    """Angles z [rad] that a gyro had turned by times t [s], without a gap where `piece` is the same.

    What it turned from rest_begin to rest_end gave its bias. Its noise is `walk` [rad^2 / s], and `by_scale` of
    every turn. The heading of reading `last` is the state `at_before`; the bias is the state `at_bias`, or `bias`
    [rad / s] where that is -1. Written is told (k, 6: verdict, landmark, NIS, threshold, y, sigma).
    """

    def __init__(
        self, when, t, z, piece, told, walk, by_scale, bias, at_bias, at_before, rest_begin, rest_end, gate,
        refused, repeated, last, readings, due,
    ):  # fmt: skip
        self.when, self.t, self.z, self.piece, self.told = when, t, z, piece, told
        self.walk, self.by_scale, self.bias = walk, by_scale, bias
        self.at_bias, self.at_before = at_bias, at_before
        self.rest_begin, self.rest_end = rest_begin, rest_end
        self.gate, self.refused, self.repeated, self.last = gate, refused, repeated, last
        self.readings, self.due = readings, due


class Sightings:
    """Detections z (k, 1 or 2: bearing [rad], range [m]) of covariance R (k, 3), reading by reading.

    Row j shows landmark which[j] of those whose numbers are `ids` and which stand at `places` (l, 2) [m, map].
    While they are `made`, they are the states `columns` (l,), of which -1 is none yet. The detector of row j sits
    at mounts[j] (k, 3: x, y, yaw) on the base. Offset and depth of its ranges are states, or given where their
    column is -1. Written are told (k, 4 + 2 numbers: verdict, landmark, NIS, threshold, y, sigma) and joint (n, 2:
    how well a reading fits as a whole). Of landmarks whose places are known it is `placed` (k, 3), where a
    detection puts them and that sigma, if the robot's own place is known to `most` [m].
    """

    def __init__(
        self, when, first, z, R, numbers, which, ids, places, columns, made, mounts, offset, depth, at_offset,
        at_depth, sigma_bearing, sigma_range, most, told, joint, placed, gate, refused, readings, due,
    ):  # fmt: skip
        self.when, self.first, self.z, self.R, self.numbers = when, first, z, R, numbers
        self.which, self.ids, self.places, self.columns, self.made = which, ids, places, columns, made
        self.mounts = mounts
        self.offset, self.depth, self.at_offset, self.at_depth = offset, depth, at_offset, at_depth
        self.sigma_bearing, self.sigma_range, self.most = sigma_bearing, sigma_range, most
        self.told, self.joint, self.placed = told, joint, placed
        self.gate, self.refused = gate, refused
        self.readings, self.due = readings, due


class Poses:
    """Poses z (k, 3) that somebody estimated, of covariance R (k, 6: 00, 01, 02, 11, 12, 22).

    They are `in_map`, or count from the pose of reading `last`, at which the states from column `at_kept` on keep
    the robot's own. One of a frame that `drifts` (k,) has the noise of `poses.way_noise`. Written is told (k, 10:
    verdict, landmark, NIS, threshold, y (3), sigma (3)).
    """

    def __init__(
        self, when, z, R, drifts, told, in_map, at_kept, by_way, turn_by_way, arm, floor, turn_floor, gate,
        refused, last, readings, due,
    ):  # fmt: skip
        self.when, self.z, self.R, self.drifts, self.told = when, z, R, drifts, told
        self.in_map, self.at_kept = in_map, at_kept
        self.by_way, self.turn_by_way, self.arm = by_way, turn_by_way, arm
        self.floor, self.turn_floor = floor, turn_floor
        self.gate, self.refused, self.last = gate, refused, last
        self.readings, self.due = readings, due


class Twists:
    """Way [m] and turn [rad] z (k, 2) until each reading, and their variance (k, 2), by a source of speeds.

    There is no gap where `piece` is the same. Its noise is also `by_scale` of way and turn squared, and a floor.
    The pose of reading `last` is kept by the states from column `at_kept` on. Written is told (k, 8: verdict,
    landmark, NIS, threshold, y (2), sigma (2)).
    """

    def __init__(
        self, when, z, variance, piece, told, at_kept, by_scale, floor, turn_floor, gate, refused, last, readings,
        due,
    ):  # fmt: skip
        self.when, self.z, self.variance, self.piece, self.told = when, z, variance, piece, told
        self.at_kept, self.by_scale, self.floor, self.turn_floor = at_kept, by_scale, floor, turn_floor
        self.gate, self.refused, self.last = gate, refused, last
        self.readings, self.due = readings, due


class Readings:
    """All single readings of a drive; how well several of one reading fit as a `whole` is noted, if asked."""

    def __init__(self, headings, bearings, echoes, fixes, turns, sightings, poses, twists, whole):
        self.headings, self.bearings, self.echoes, self.fixes = headings, bearings, echoes, fixes
        self.turns, self.sightings, self.poses, self.twists = turns, sightings, poses, twists
        self.whole = whole


class Window:
    """The part of a picture that holds the mirror, `height` by `width` pixels from (`left`, `top`) on.

    `excess` is red less the greater of green and blue, `red` is red, and a pixel is red where the excess is at
    least `least` (256,) of its red. `points` (n, 2) are where there is any: x, y in the window. The mirror's axis
    is at (x_c, y_c) of the picture, which has so many pixels `across` and `down` and may `cut` the mirror. A thing
    has at least the `fewest` pixels and no `gap` [px]. Room: theta, radius, level, edge, order, room (n,), rings.
    """

    def __init__(
        self, excess, red, least, points, height, width, left, top, x_c, y_c, across, down, cut, fewest, gap,
        theta, radius, level, edge, order, room, rings,
    ):  # fmt: skip
        self.excess, self.red, self.least, self.points = excess, red, least, points
        self.height, self.width, self.left, self.top = height, width, left, top
        self.x_c, self.y_c, self.across, self.down = x_c, y_c, across, down
        self.cut, self.fewest, self.gap = cut, fewest, gap
        self.theta, self.radius, self.level, self.edge = theta, radius, level, edge
        self.order, self.room, self.rings = order, room, rings


class Notes:
    """What `note` writes at every instant; room (9,)."""

    def __init__(self, room, pose, triangle, columns, blocks, values):
        self.room, self.pose, self.triangle = room, pose, triangle
        self.columns, self.blocks, self.values = columns, blocks, values
