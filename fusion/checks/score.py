"""Does a fix help? One configuration's figures before and after, by truth, else by what it predicts."""

from __future__ import annotations

import math
from typing import NamedTuple

MAX_LOSS, MAX_LOSS_M = 0.02, 2e-4  # relative, m: by which no position error may grow
MAX_CHANCE_LOSS = 0.15  # relative, of the position error of a configuration that nobody would keep
MAX_RUIN, MAX_RUIN_NATS = 1.0, 0.2  # relative, nats per number: more than chance does to any configuration
MAX_LN_ANEES_LOSS = 0.1  # by which ln ANEES may leave its chance range further where the error stays the same
MIN_GAIN = 0.1  # relative gain of the position error
MIN_TURN_DEG = 0.1  # by which a heading error must change, and by how much it may grow beside MAX_LOSS
MIN_LN_ANEES_GAIN = 0.2  # by which ln ANEES must come nearer to its chance range
MAX_SETTLED_SHARE = 0.5  # of the error before: a fix that leaves less is right, whatever chance does elsewhere
MAX_TURNED_SHARE = 1.0 / 3.0  # of the heading error: a fix that takes more away is right
MIN_GAIN_M = 2e-4  # m: smaller gains of the position error are none, however large their share
MAX_LOSS_NATS, MIN_GAIN_NATS = 0.02, 0.05  # nats per number; a sigma 10 % off costs about 0.01, 50 % about 0.1
MAX_CHANCE_LOSS_NATS = MIN_GAIN_NATS  # nats per number, of a configuration that nobody would keep
MAX_LOST_SHARE = 0.005  # of the drive: by which being lost may grow
WEIGHT_OF_HEADING = 0.5  # of a factor on the heading error, against one on the position error
WEIGHT_OF_ANEES = 0.5  # of a factor on ANEES, against one on the position error


class Score(NamedTuple):
    """One configuration's figures under some settings."""

    position: float | None = None  # m, position rmse against truth
    anees: float | None = None
    bounds: tuple[float, float] | None = None  # where a consistent filter's ANEES lies on such a drive
    prediction: float | None = None  # nats per number of the sensors that only listened; without truth
    lost: float = 0.0  # share of the drive
    shape: float | None = None  # m, position rmse of the path laid on the truth as a whole
    aligned: bool = False  # `position` is that of the shape
    heading: float | None = None  # deg, heading rmse against truth

    def of_shape(self) -> Score:
        """Return the score of the path's shape alone: where it lies in the world does not count."""
        return self._replace(position=self.shape, anees=None, bounds=None, aligned=True, heading=None)


def spoils(before: Score, after: Score, allowed: float = MAX_LOSS, allowed_nats: float = MAX_LOSS_NATS) -> bool:
    """Return whether any figure gets notably worse or is missing.

    `allowed` is the share by which the position error may grow, `allowed_nats` what a prediction may lose.
    """
    if after.lost > before.lost + MAX_LOST_SHARE:
        return True
    if before.position is not None:
        if after.position is None or after.position > before.position * (1.0 + allowed) + MAX_LOSS_M:
            return True
        much_smaller = after.position < (1.0 - MIN_GAIN) * before.position
        if after.position >= MAX_SETTLED_SHARE * before.position and _turns_worse(before, after, allowed):
            return True
        return not much_smaller and _off(after) > _off(before) + MAX_LN_ANEES_LOSS
    if before.prediction is not None:
        return after.prediction is None or after.prediction < before.prediction - allowed_nats
    return False


def _turns_worse(before: Score, after: Score, allowed: float) -> bool:
    """Return whether the heading error grows by more than the share that is `allowed` and MIN_TURN_DEG."""
    if before.heading is None or after.heading is None:
        return False
    return after.heading > (1.0 + allowed) * before.heading + MIN_TURN_DEG


def turns_right(before: Score, after: Score) -> bool:
    """Return whether the heading error falls by more than a third: more than chance on one drive."""
    return _turned(before, after) > -math.log(1.0 - MAX_TURNED_SHARE)


def spoils_alone(before: Score, after: Score) -> bool:
    """Return whether a configuration that no user would keep gets notably worse.

    One drive's error moves by many percent with every other way of weighing the same readings, by chance: such a
    configuration may not hinder what helps the better ones.
    """
    return spoils(before, after, MAX_CHANCE_LOSS, MAX_CHANCE_LOSS_NATS) and not _only_underconfident(before, after)


def _only_underconfident(before: Score, after: Score) -> bool:
    """Return whether, apart from chance, only the claimed uncertainty grows: no harm."""
    if before.position is None or after.position is None or after.lost > before.lost + MAX_LOST_SHARE:
        return False
    small = after.position <= before.position * (1.0 + MAX_CHANCE_LOSS) + MAX_LOSS_M
    return small and after.anees is not None and after.anees < 1.0


def ruins(before: Score, after: Score) -> bool:
    """Return whether a configuration gets worse by far more than chance explains."""
    if after.lost > before.lost + MAX_LOST_SHARE:
        return True
    if before.position is not None:
        return after.position is None or after.position > (1.0 + MAX_RUIN) * before.position
    if before.prediction is not None:
        return after.prediction is None or after.prediction < before.prediction - MAX_RUIN_NATS
    return False


def was_chance(before: Score, after: Score) -> bool:
    """Return whether a smaller error before was chance: that run was inconsistent, and the new one is not."""
    if before.position is None or not after.anees:
        return False
    return _off(before) > MIN_LN_ANEES_GAIN and _off(after) == 0.0


def leaves(before: Score, after: Score) -> bool:
    """Return whether an ANEES leaves its chance range."""
    return before.bounds is not None and _off(before) == 0.0 and _off(after) > MAX_LN_ANEES_LOSS


def improves(before: Score, after: Score) -> bool:
    """Return whether one figure gets notably better. An ANEES within its chance range has nothing to gain."""
    if before.lost - after.lost > MAX_LOST_SHARE:
        return True
    if before.position is not None and after.position is not None:
        less = before.position - after.position
        if less > max(MIN_GAIN * before.position, MIN_GAIN_M) or (less >= 0.0 and _turned(before, after) > 0.0):
            return True
        if turns_right(before, after) and less >= -MAX_CHANCE_LOSS * before.position:
            return True
        nearer = _off(before) - _off(after)
        # and outweighs an error that grows: 220 and 176 are both far off
        return nearer > MIN_LN_ANEES_GAIN and gain(before, after) > WEIGHT_OF_ANEES * MIN_LN_ANEES_GAIN - 1e-9
    if before.prediction is not None and after.prediction is not None:
        return after.prediction - before.prediction > MIN_GAIN_NATS
    return False


def settles(before: Score, after: Score) -> bool:
    """Return whether a configuration's error falls to less than half: more than chance on one drive."""
    if before.position is None or after.position is None:
        return False
    return after.position < MAX_SETTLED_SHARE * before.position and not spoils(before, after)


def gain(before: Score, after: Score) -> float:
    """Return how much a fix is worth: ln of the factor on the position error, and half of that on ANEES."""
    if before.position is not None and after.position is not None:
        turned = WEIGHT_OF_HEADING * _turned(before, after)
        return (
            _less(before, after)
            + turned
            + WEIGHT_OF_ANEES * (_off(before) - _off(after))
            + before.lost
            - after.lost
        )
    if before.prediction is not None and after.prediction is not None:
        return after.prediction - before.prediction + before.lost - after.lost
    return 0.0


def _turned(before: Score, after: Score) -> float:
    """Return ln of how many times smaller the heading error gets, 0 if the change is negligible."""
    if before.heading is None or after.heading is None:
        return 0.0
    small = abs(before.heading - after.heading) < max(MIN_TURN_DEG, MIN_GAIN * before.heading)
    return 0.0 if small else math.log(before.heading / max(after.heading, MIN_TURN_DEG))


def _less(before: Score, after: Score) -> float:
    """Return ln of how many times smaller the position error gets."""
    if before.position is None or after.position is None:
        return 0.0
    return math.log(max(before.position, MIN_GAIN_M) / max(after.position, MIN_GAIN_M))


def _off(score: Score) -> float:
    """Return how far ln ANEES lies outside its chance range, 0 inside it or where there is none.

    Inside, one drive cannot tell one ANEES from another: 0.73 before and 0.47 after are no loss.
    """
    if not score.anees:
        return 0.0
    low, high = score.bounds or (1.0, 1.0)
    return max(0.0, math.log(score.anees / high), math.log(low / score.anees))
