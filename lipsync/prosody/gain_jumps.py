"""Jumps of a microphone's gain: with an automatic one, loudness says less of the voice."""

from collections import deque

_FRAMES_PER_S = 100
#: The noise floor of each second; three of them hold a pause or a stop closure of any speech.
_SECONDS = 3
#: A floor that moved so much in 3 s: fans and traffic stay within it.
_JUMP_DB = 6.0
#: Below it there is no microphone's noise to compare with: digital silence between played words.
_LEAST_FLOOR_DB = -75.0
#: So long until loudness counts in full again.
_RECOVERY_FRAMES = 20.0 * _FRAMES_PER_S


class GainJumpDetector:
    """Watches the noise floor: what lifts the voice and the noise together is the microphone.

    A voice that grows louder, or comes nearer, leaves the noise as it is. A noise that is switched
    on looks like a jump as well; it costs the loudness its weight for a while, no more.
    """

    def __init__(self) -> None:
        self._floors_db: deque[float] = deque(maxlen=2 * _SECONDS)
        self._lowest_db = 0.0
        self._n_in_second = 0
        self._n_since = _RECOVERY_FRAMES

    @property
    def trust(self) -> float:
        """How far loudness may be trusted: 0 just after a jump, 1 after 20 s without."""
        return min(1.0, self._n_since / _RECOVERY_FRAMES)

    def push(self, level_db: float) -> bool:
        """Take the level of the next 10 ms, silence or not; True where a jump is noticed."""
        self._n_since += 1
        self._lowest_db = min(self._lowest_db, level_db)
        self._n_in_second += 1
        if self._n_in_second < _FRAMES_PER_S:
            return False
        self._floors_db.append(self._lowest_db)
        self._lowest_db, self._n_in_second = 0.0, 0
        if len(self._floors_db) < 2 * _SECONDS:
            return False
        floors_db = list(self._floors_db)
        before_db, now_db = min(floors_db[:_SECONDS]), min(floors_db[_SECONDS:])
        if min(before_db, now_db) < _LEAST_FLOOR_DB or abs(now_db - before_db) < _JUMP_DB:
            return False
        self._n_since = 0.0
        # The next jump is one from here.
        self._floors_db.clear()
        return True
