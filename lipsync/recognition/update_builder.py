"""From one phoneme a frame to updates that never take back what is final."""

from collections.abc import Sequence
from itertools import groupby

from lipsync.phonemes import SILENCE, PhonemeEvent, PhonemeUpdate


class UpdateBuilder:
    """Turns a recogniser's phonemes, one for each frame, into `PhonemeUpdate`s.

    Frames count from sound time 0, `frames_per_s` a second. The first `n_final` frames are final:
    at each update all but the last `latency_frames` become so. An event is a run of equal frames.
    """

    def __init__(self, frames_per_s: int, latency_frames: int) -> None:
        self._frames_per_s = frames_per_s
        self._latency_frames = latency_frames
        self._n_final = 0
        self._last_final = SILENCE
        self._run_start = 0  # the first frame of the run that the last final frame belongs to

    @property
    def n_final(self) -> int:
        """How many frames are final; also the number of the first that is not."""
        return self._n_final

    def update(self, phonemes: Sequence[str]) -> PhonemeUpdate:
        """The update when `phonemes` are those of the frames from the first not final to now.

        The first event keeps the start it had when the last final frame belongs to it.
        """
        runs = self._runs(phonemes)
        replace_from, heard = self._n_final, self._n_final + len(phonemes)
        self._n_final = max(self._n_final, heard - self._latency_frames)
        for phoneme, start in runs:
            if start < self._n_final:
                self._last_final, self._run_start = phoneme, start
        ends = [start for _, start in runs[1:]]
        return PhonemeUpdate(
            replace_from_s=replace_from / self._frames_per_s,
            heard_until_s=heard / self._frames_per_s,
            final_until_s=self._n_final / self._frames_per_s,
            events=tuple(
                PhonemeEvent(
                    phoneme,
                    start / self._frames_per_s,
                    None if end is None else end / self._frames_per_s,
                )
                for (phoneme, start), end in zip(runs, [*ends, None], strict=True)
            ),
        )

    def _runs(self, phonemes: Sequence[str]) -> list[tuple[str, int]]:
        """(phoneme, first frame) of each run of equal phonemes."""
        runs, start = [], self._n_final
        for phoneme, frames in groupby(phonemes):
            goes_on = start == self._n_final > 0 and phoneme == self._last_final
            runs.append((phoneme, self._run_start if goes_on else start))
            start += len(list(frames))
        return runs
