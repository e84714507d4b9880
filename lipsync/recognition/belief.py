"""From one phoneme a frame to updates that never take back what is final."""

from collections.abc import Sequence
from itertools import groupby

from lipsync.phonemes import SILENCE, PhonemeEvent, PhonemeUpdate


class FrameBelief:
    """Turns a recogniser's phonemes, one for each frame, into `PhonemeUpdate`s.

    Frames count from sound time 0, `frames_per_s` a second. Frames before `border` are final: at
    each update all but the last `latency_frames` become so. An event is a run of equal frames.
    """

    def __init__(self, frames_per_s: int, latency_frames: int) -> None:
        self._frames_per_s = frames_per_s
        self._latency_frames = latency_frames
        self._border = 0
        self._last_final = SILENCE
        self._run_start = 0  # the first frame of the run that the last final frame belongs to

    @property
    def border(self) -> int:
        """The first frame that is not final yet."""
        return self._border

    def update(self, phonemes: Sequence[str]) -> PhonemeUpdate:
        """What to say when `phonemes` are those of the frames from the border to now.

        The first event keeps the start it had when the frame before the border belongs to it.
        """
        runs = self._runs(phonemes)
        replace_from, heard = self._border, self._border + len(phonemes)
        self._border = max(self._border, heard - self._latency_frames)
        for phoneme, start in runs:
            if start < self._border:
                self._last_final, self._run_start = phoneme, start
        ends = [start for _, start in runs[1:]]
        return PhonemeUpdate(
            replace_from_s=replace_from / self._frames_per_s,
            heard_until_s=heard / self._frames_per_s,
            final_until_s=self._border / self._frames_per_s,
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
        runs, start = [], self._border
        for phoneme, frames in groupby(phonemes):
            goes_on = start == self._border > 0 and phoneme == self._last_final
            runs.append((phoneme, self._run_start if goes_on else start))
            start += len(list(frames))
        return runs
