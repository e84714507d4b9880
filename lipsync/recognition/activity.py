"""Voice activity from the network's own posterior of silence; no other detector."""

from lipsync.recognition.features import FRAMES_PER_S

#: A stop gap inside a word lasts to 120 ms; a mouth that closes must have begun within 250 ms.
HANG_OVER_S = 0.15


class VoiceActivity:
    """Speech from the first frame that is rather not silence to 150 ms after the last one."""

    def __init__(self) -> None:
        self._n_silent = round(HANG_OVER_S * FRAMES_PER_S)

    @property
    def is_speaking(self) -> bool:
        """Whether speech is going on."""
        return self._n_silent < round(HANG_OVER_S * FRAMES_PER_S)

    def hear(self, silence: float) -> None:
        """Take the posterior of silence (0 to 1) of the next 10 ms frame."""
        is_silent = silence > 0.5
        self._n_silent = self._n_silent + 1 if is_silent else 0
