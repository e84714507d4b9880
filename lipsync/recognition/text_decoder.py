"""From posteriors and a known text to phonemes, by following the voice through its text.

The words are a graph from left to right: silence may come before each, each has one or several
pronunciations, one may be left out, repeated or broken off, at a penalty. Beside it runs a path
without constraint, the escape, which costs a little more in every frame than the likeliest phoneme
does: it wins where the sound does not follow the text, and there the recognised phonemes count.
The search over both is Viterbi's (Rabiner, Proceedings of the IEEE 77(2), 1989); the escape is the
filler model of keyword spotting (Rose and Paul, ICASSP 1990).

A frame's scores change until the last of the network's heads has scored it. So a step of the search
is final only up to the frame that the last head has just scored; later frames are searched anew.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array32
from lipsync.errors import UserError
from lipsync.phonemes import PHONEMES
from lipsync.recognition.decoder import SILENCE_INDEX, PosteriorFormat, best_heads
from lipsync.spoken_text import PronouncedWord

#: In place of a phoneme's number: the escape wins here, so the recognised phoneme counts.
OUTSIDE_TEXT: Final = -1
#: Pronunciations of a word that are searched; the dictionary's first ones.
MOST_PRONUNCIATIONS: Final = 4
#: Words that may wait to be spoken: ten minutes of speech.
MOST_WORDS: Final = 2_000
#: The search's window: it begins so many words before the present one, and has so many.
_BEHIND, _WINDOW = 3, 14
_NEVER: Final = np.float32(-1e9)
_NO_WORDS: Final = np.zeros(0, np.float32)
_INDEX: Final = {phoneme: index for index, phoneme in enumerate(PHONEMES)}


#: What moves the mouth: sound that is heard, a text or words (or phonemes without times) followed
#: in it, phonemes or visemes that are known.
MovedBy = Literal["sound", "text", "words", "phonemes", "visemes"]


class TextError(UserError):
    """Error for words that cannot be followed in the sound; the message is one line."""


@runtime_checkable
class MouthMover(Protocol):
    """A source of phonemes that reports their origin and the words being spoken."""

    @property
    def moved_by(self) -> MovedBy | None:
        """The origin of the phonemes now final (`sound`, `text`, ...); None if not known."""

    @property
    def saying(self) -> tuple[tuple[str, ...], int]:
        """The words around the one being spoken, and its index among them; ((), 0) without text."""


@runtime_checkable
class TextFollower(MouthMover, Protocol):
    """A recogniser that finds given words in the sound."""

    def tell(self, words: Sequence[PronouncedWord], behind_s: float = 0.0) -> None:
        """Add the words that come next in the sound, after all words given before.

        They may be added before their sound, with it or late.

        behind_s: seconds of their sound that were fed already. Raises TextError for too many words.
        """

    def forget(self) -> None:
        """Drop the words given by `tell` that are not spoken yet."""


@dataclass(frozen=True, slots=True)
class TextSettings:
    """Costs in natural-log units, chosen on two talkers that are not scored (docs/recognition.md).

    settled_frames: frames after which the path to a frame is final. n_heads: how many heads of the
    network are used, the quickest; the one that waits longest adds nothing where words are known.
    lowest: least score of a phoneme in one frame, relative to the likeliest. silence: cost of every
    silent frame. pause: cost of silence between two words. left_out: of each word that is left out;
    again: of going back. escape: of every frame on the escape; leave, resume: of a change to it and
    back; leave_pause: of a change to it from silence, where other words begin most often.
    least_frames: least duration of a phoneme. late_s: how far a word with a time may begin from
    it without cost; late: cost of each second beyond.
    """

    settled_frames: int = 17
    n_heads: int = 2
    lowest: float = -7.0
    silence: float = 0.8
    pause: float = 1.0
    left_out: float = 8.0
    again: float = 12.0
    escape: float = 1.2
    leave: float = 20.0
    leave_pause: float = 12.0
    resume: float = 25.0
    least_frames: int = 3
    late_s: float = 0.15
    late: float = 100.0


FOLLOWING: Final = TextSettings()


class TextDecoder:
    """Decoder of scores to the phonemes of a text, frame by frame; words are added at any time."""

    def __init__(
        self,
        posterior_format: PosteriorFormat,
        frames_per_s: int,
        first_frame: int = 0,
        settings: TextSettings = FOLLOWING,
    ) -> None:
        """Create the decoder for posteriors of the given format.

        first_frame: the number, in the stream, of the first frame that will be pushed. Raises
        ValueError if a path would be settled before the last head used has scored it.
        """
        self._delays = posterior_format.delays[: settings.n_heads]
        if settings.settled_frames < self._delays[-1]:
            raise ValueError("the decoder settles words before its last head has scored them")
        self._settings = settings
        self._frames_per_s = frames_per_s
        self._pause_cost = np.float32(settings.pause)
        self._silence_cost = np.float32(settings.silence)
        self._least_score = np.float32(settings.lowest)
        self._late_cost = np.float32(settings.late / frames_per_s)
        self._tolerance = np.float32(settings.late_s * frames_per_s)
        self._heads = best_heads(self._delays, self._delays[-1])
        n_recent = self._delays[-1] + 1
        # Scores of the last frames by each head, by frame number modulo the length.
        self._recent = np.zeros((n_recent, len(self._delays), len(PHONEMES)), np.float32)
        self._first_frame = first_frame
        self._n_heard = 0
        self._n_idle = 0  # frames since all words were spoken
        self._words = _WordGraph(settings)
        window = self._words.window(0)
        scores = np.full(window.n_states, _NEVER)
        scores[0] = 0.0
        self._newest = _Front(window, scores, np.float32(0.0), _NO_WORDS)
        n_final = settings.settled_frames - self._delays[-1] + 1
        self._final_fronts: deque[_Front] = deque([self._newest], maxlen=n_final + 1)
        self._place = 0.0  # number of the word being spoken; grows by parts of 1 on the escape

    @property
    def place(self) -> int:
        """The number, from 0, of the word being spoken, by the final part of the best path."""
        return int(self._place)

    @property
    def saying(self) -> tuple[tuple[str, ...], int]:
        """The words around the one being spoken, and its index among them."""
        return self._words.labels_around(self.place)

    @property
    def is_over(self) -> bool:
        """Whether all words were spoken or left out more than a second ago."""
        return self._n_idle > _IDLE_S * self._frames_per_s

    def tell(self, words: Sequence[PronouncedWord], behind_s: float = 0.0) -> None:
        """Add words of the text after all earlier ones. Raises TextError for too many words.

        behind_s: seconds of their sound heard already; for words without times the search goes on
        at the word that is likely spoken by then.
        """
        n_waiting = self._words.n_words - self.place + len(words)
        if n_waiting > MOST_WORDS:
            raise TextError(
                f"{n_waiting} words wait to be spoken, at most {MOST_WORDS} may; send fewer at once"
            )
        n_behind = min(len(words), int(behind_s * _WORDS_PER_S))
        is_timed = any(word.start_s is not None for word in words)
        present = self._words.n_words + n_behind
        self._words.append(words, self._frames_per_s)
        self._n_idle = 0
        if n_behind and not is_timed:
            self._place = float(present)
            window = self._words.window(present)
            self._set_newest(window, np.full(window.n_states, _NEVER), np.float32(0.0))

    def forget(self) -> None:
        """Drop the words given by `tell` that are not spoken yet."""
        newest = self._newest
        state = int(newest.scores.argmax())
        place = self.place
        # Where the escape (speech outside the text) is the likeliest path, the place stays.
        if newest.escape < newest.scores[state]:
            # A word has not begun while the likeliest state is the silence before it.
            has_begun = newest.window.kinds[state] != _SILENT
            place = newest.window.first_word + int(newest.window.words[state]) - (not has_begun)
        self._words.drop_after(place)
        self._place = min(self._place, float(self._words.n_words))
        window = self._words.window(self.place)
        self._set_newest(window, window.scores_from(newest), newest.escape)

    def _set_newest(self, window: "_Window", scores: Array32, escape: np.float32) -> None:
        """Replace the newest final front by one on `window`; the words' `begins` are kept."""
        begins = np.full(len(window.silences), _NEVER)
        known = self._newest.begins[max(0, window.first_word - self._newest.window.first_word) :]
        begins[: len(known)] = known[: len(begins)]
        self._newest = self._final_fronts[-1] = _Front(window, scores, escape, begins)

    def jump(self, n_frames: int) -> None:
        """Advance the frame number by `n_frames` of silence in a long gap, which are not pushed."""
        self._first_frame += n_frames

    def push(self, scores: Array32) -> list[int]:
        """Decode one frame of scores, and update `place`, the word being spoken.

        Parameters
        ----------
        scores : Array32
            (n_heads, n_phonemes), logarithms; head h's row is of the frame delays[h] frames ago.

        Returns
        -------
        list[int]
            Phonemes' numbers in `PHONEMES` for the newest frames in order, which may change in the
            next call; `OUTSIDE_TEXT` where the sound does not follow the text. [] before the first.
        """
        n, length = self._n_heard, len(self._recent)
        self._n_heard += 1
        scores = scores[: len(self._delays)]
        relative = np.maximum(scores - scores.max(axis=1, keepdims=True), self._least_score)
        relative[:, SILENCE_INDEX] -= self._silence_cost
        for head, delay in enumerate(self._delays):
            if delay <= n:
                self._recent[(n - delay) % length, head] = relative[head]
        oldest, newest = n - self._delays[-1], n - self._delays[0]
        if newest < 0:
            return []
        # The frame that the last head has just scored is final; newer ones are searched on trial.
        if oldest >= 0:
            self._newest = self._step(self._newest, oldest, self._delays[-1], is_final=True)
            self._final_fronts.append(self._newest)
        front = self._newest
        provisional = []
        for frame in range(max(0, oldest + 1), newest + 1):
            front = self._step(front, frame, n - frame)
            provisional.append(front)
        return self._trace_back([*self._final_fronts, *provisional])

    def _step(self, front: "_Front", frame: int, age: int, *, is_final: bool = False) -> "_Front":
        """Return the search's scores after frame number `frame`; `front`: those before it.

        age: frames heard since, which chooses the head. is_final: then the window of words may move
        and scores are normalised; other steps are searched again in the next frame.
        """
        settings = self._settings
        window = self._words.window(self.place) if is_final else front.window
        scores = front.scores if window is front.window else window.scores_from(front)
        row = self._recent[frame % len(self._recent), self._heads[age - self._delays[0]]]
        # What each state is entered with: from the state before it; silence before a word from any
        # word's end; a word's first state from such an end, or from the silence before the word.
        begins = self._start_scores(window, scores, front.escape)
        entered = np.empty_like(scores)
        entered[1:] = scores[:-1]
        entered[window.silences] = begins - self._pause_cost
        to_first = np.maximum(begins, scores.take(window.silences))
        if window.has_times:
            off_frames = np.abs(window.start_frames - np.float32(frame + self._first_frame))
            to_first -= np.fmax(np.float32(0.0), off_frames - self._tolerance) * self._late_cost
        entered[window.firsts] = to_first.take(window.word_of_first)
        new_scores = np.maximum(scores + window.stays, entered)
        new_scores += row.take(window.phonemes)
        best_exit = max(
            np.maximum.reduce(scores) - np.float32(settings.leave),
            np.maximum.reduce(scores.take(window.silences)) - np.float32(settings.leave_pause),
        )
        escape = max(front.escape, best_exit) - np.float32(settings.escape)
        if is_final:
            best = max(np.maximum.reduce(new_scores), escape)
            new_scores -= best
            escape -= best
        return _Front(window, new_scores, escape, begins)

    def _start_scores(self, window: "_Window", scores: Array32, escape: np.float32) -> Array32:
        """Return the best score (n_words,) with which each word of a window may begin now."""
        ends = np.empty(window.ends.shape[1] + 1, np.float32)
        np.maximum.reduce(scores.take(window.ends), axis=0, out=ends[:-1])
        ends[-1] = escape
        begins: Array32 = np.maximum.reduce(ends[:, None] + window.between, axis=0)
        return begins

    def _trace_back(self, fronts: "list[_Front]") -> list[int]:
        """Return the best path's phoneme in each front but the first; set `_place` from the first.

        A phoneme's number in `PHONEMES`, or `OUTSIDE_TEXT`.
        """
        last = fronts[-1]
        state = int(last.scores.argmax())
        is_escape = bool(last.escape >= last.scores[state])
        path: list[int] = []
        for front, before in zip(fronts[:0:-1], fronts[-2::-1], strict=True):
            if is_escape:
                path.append(OUTSIDE_TEXT)
                exit_score, exit_state = self._best_exit(before)
                if exit_score > before.escape:
                    is_escape, state = False, exit_state
                continue
            path.append(int(front.window.phonemes[state]))
            is_escape, state = self._predecessor(front, before, state)
        # Beside the text its words are assumed to pass at the pace of slow speech.
        n_words = self._words.n_words
        if is_escape:
            self._place = min(self._place + _ESCAPED_WORDS_PER_FRAME, float(n_words))
        else:
            window = fronts[0].window
            self._place = float(window.first_word + window.words[state])
        self._n_idle = self._n_idle + 1 if self._place >= n_words else 0
        return path[::-1]

    def _best_exit(self, front: "_Front") -> tuple[np.float32, int]:
        """Return the best score of a change from the text to the escape, and the state left."""
        best = int(front.scores.argmax())
        pause = int(front.window.silences[front.scores.take(front.window.silences).argmax()])
        from_best = front.scores[best] - np.float32(self._settings.leave)
        from_pause = front.scores[pause] - np.float32(self._settings.leave_pause)
        return (from_pause, pause) if from_pause > from_best else (from_best, best)

    def _predecessor(self, front: "_Front", before: "_Front", state: int) -> tuple[bool, int]:
        """Return where the best path to `state` in `front` came from, one frame earlier.

        (False, its state in `before`), or (True, `state`) if it came from the escape.
        """
        window = front.window
        scores = before.scores if before.window is window else window.scores_from(before)
        shift = window.first_state - before.window.first_state
        stay = scores[state] + window.stays[state]
        kind = window.kinds[state]
        if kind == _WITHIN:
            return False, (state if stay >= scores[state - 1] else state - 1) + shift
        word = int(window.words[state])
        begins = front.begins
        if kind == _SILENT:
            if stay >= begins[word] - np.float32(self._settings.pause):
                return False, state + shift
        else:
            silence = int(window.silences[word])
            if max(stay, scores[silence]) >= begins[word]:
                return False, (state if stay >= scores[silence] else silence) + shift
        # From the end of a word (its best pronunciation), or from the escape.
        ends = scores[window.ends].max(axis=0)
        from_words = np.append(ends, before.escape) + window.between[:, word]
        source = int(from_words.argmax())
        if source == len(ends):
            return True, state
        candidates = window.ends[:, source]
        return False, int(candidates[scores[candidates].argmax()]) + shift


@dataclass(frozen=True, slots=True)
class _Window:
    """The words that the search goes through now, as arrays over their states or over words.

    Arrays as in `_Words`, but states and words count from the window's first. between: scores of
    `_transition_scores`. has_times: whether a word of the window has a time.
    """

    first_word: int
    first_state: int
    n_states: int
    phonemes: NDArray[np.int64]
    stays: Array32
    kinds: NDArray[np.int8]
    words: NDArray[np.int64]
    silences: NDArray[np.int64]
    firsts: NDArray[np.int64]
    word_of_first: NDArray[np.int64]
    ends: NDArray[np.int64]
    between: Array32
    start_frames: Array32
    has_times: bool

    def scores_from(self, front: "_Front") -> Array32:
        """Return the scores (n_states,) of this window's states in `front`; -1e9 if not there."""
        scores = np.full(self.n_states, _NEVER)
        shift = front.window.first_state - self.first_state
        first, end = max(0, shift), min(self.n_states, shift + front.window.n_states)
        scores[first:end] = front.scores[first - shift : end - shift]
        return scores


@dataclass(frozen=True, slots=True)
class _Front:
    """The search's scores after a frame: of the best path to each state, and to the escape.

    scores: (n_states,). begins: (n_words,), the score with which each word could begin then.
    """

    window: _Window
    scores: Array32
    escape: np.float32
    begins: Array32


#: Kinds of states: within a word, the silence before a word, a pronunciation's first state.
_WITHIN, _SILENT, _FIRST = 0, 1, 2
#: Speed of read speech with its pauses; a window reaches several words to both sides.
_WORDS_PER_S: Final = 2.6
#: On the escape the present word advances as in slow speech: 2 words a second at 100 frames.
_ESCAPED_WORDS_PER_FRAME: Final = 0.02
#: The text is over so long after its last word.
_IDLE_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class _Words:
    """Words as states in one row; each word is silence, then its pronunciations in succession.

    States and words keep their numbers when earlier ones are dropped. Of each state: phonemes;
    stays, the score of staying in it; kinds (`_WITHIN`, ...); words, its word's number. firsts: the
    first state of each pronunciation; word_of_first: its word. Of each word: silences (n_words,),
    the state of the silence before it; ends (4, n_words), the last state of each pronunciation;
    start_frames (n_words,), when it should begin, NaN: unknown.
    """

    phonemes: NDArray[np.int64]
    stays: Array32
    kinds: NDArray[np.int8]
    words: NDArray[np.int64]
    firsts: NDArray[np.int64]
    word_of_first: NDArray[np.int64]
    silences: NDArray[np.int64]
    ends: NDArray[np.int64]
    start_frames: Array32

    def part(self, first: int, end: int) -> "_Words":
        """Return the words numbered from `first` to before `end`."""
        states = slice(*np.searchsorted(self.words, (first, end)))
        firsts = slice(*np.searchsorted(self.word_of_first, (first, end)))
        words = slice(first - int(self.words[0]), end - int(self.words[0]))
        return _Words(
            self.phonemes[states], self.stays[states], self.kinds[states], self.words[states],
            self.firsts[firsts], self.word_of_first[firsts],
            self.silences[words], self.ends[:, words], self.start_frames[words],
        )  # fmt: skip


class _WordGraph:
    """The given words as states, laid out once, so that a tick only cuts a window out of them."""

    def __init__(self, settings: TextSettings) -> None:
        self._settings = settings
        self._labels: list[str] = []
        self._words = _final_silence(0, 0)
        self._first_word = 0  # of the window, which does not go back
        self._window: _Window | None = None

    @property
    def n_words(self) -> int:
        """The number of words given so far, spoken and dropped ones included."""
        return int(self._words.words[-1])

    def append(self, words: Sequence[PronouncedWord], frames_per_s: int) -> None:
        """Append words, which become states; drop the words before the present window."""
        end_state = int(self._words.silences[-1])
        parts = [self._words.part(self._first_word, self.n_words)]
        for number, word in enumerate(words, self.n_words):
            least_frames = self._settings.least_frames
            parts.append(_word_states(word, number, end_state, least_frames, frames_per_s))
            end_state += len(parts[-1].phonemes)
        self._labels = [*self._labels_from(self._first_word), *(word.label for word in words)]
        self._lay_out(*parts, _final_silence(self.n_words + len(words), end_state))

    def drop_after(self, number: int) -> None:
        """Drop all words after word number `number`."""
        first, end = int(self._words.words[0]), max(self._first_word, min(number + 1, self.n_words))
        end_state = int(self._words.silences[end - first])
        del self._labels[end - first :]
        self._lay_out(self._words.part(first, end), _final_silence(end, end_state))

    def _lay_out(self, *parts: _Words) -> None:
        """Replace the words of the graph by `parts`, concatenated, and drop the cached window.

        The next call of `window` computes the window again.
        """
        self._words = _Words(
            *(
                np.concatenate([getattr(part, name) for part in parts], axis=-1)
                for name in _Words.__slots__
            )
        )
        self._window = None

    def labels_around(self, place: int) -> tuple[tuple[str, ...], int]:
        """Return the labels of up to 14 words around word number `place`, and that one's index."""
        return tuple(self._labels_from(self._first_word)[:_WINDOW]), place - self._first_word

    def _labels_from(self, number: int) -> list[str]:
        return self._labels[number - int(self._words.words[0]) :]

    def window(self, place: int) -> _Window:
        """Return the window around word number `place`; the silence at the end counts as a word."""
        first = self._first_word = max(self._first_word, min(place, self.n_words) - _BEHIND)
        if self._window is None or self._window.first_word != first:
            end = first + _WINDOW
            words = self._words.part(first, end if end < self.n_words else self.n_words + 1)
            self._window = _make_window(words, min(place, self.n_words) - first, self._settings)
        return self._window


def _final_silence(number: int, first_state: int) -> _Words:
    """Return the silence after the last word: one state, as a word numbered `number`.

    first_state: the number of that state. The word has no pronunciation.
    """
    none, one = np.zeros(0, np.int64), np.zeros(1, np.int64)
    return _Words(
        one + SILENCE_INDEX, np.zeros(1, np.float32), np.full(1, _SILENT, np.int8), one + number,
        none, none,
        one + first_state, np.full((MOST_PRONUNCIATIONS, 1), first_state),
        np.full(1, np.nan, np.float32),
    )  # fmt: skip


def _word_states(
    word: PronouncedWord, number: int, first_state: int, least_frames: int, frames_per_s: int
) -> _Words:
    """Return a word as states: one of silence, then `least_frames` states for each phoneme.

    number: the word's; first_state: the number of its first state. A path may stay in silence and
    in a phoneme's last state only, so a phoneme lasts `least_frames` at least.
    """
    phonemes, stays, kinds, ends = [SILENCE_INDEX], [np.float32(0.0)], [_SILENT], []
    for pronunciation in word.pronunciations[:MOST_PRONUNCIATIONS]:
        kinds += [_FIRST] + [_WITHIN] * (len(pronunciation) * least_frames - 1)
        for phoneme in pronunciation:
            phonemes += [_INDEX[phoneme]] * least_frames
            stays += [_NEVER] * (least_frames - 1) + [np.float32(0.0)]
        ends.append(first_state + len(phonemes) - 1)
    ends += [ends[0]] * (MOST_PRONUNCIATIONS - len(ends))
    firsts = first_state + np.flatnonzero(np.array(kinds) == _FIRST)
    start = np.nan if word.start_s is None else word.start_s * frames_per_s
    return _Words(
        np.array(phonemes), np.array(stays, np.float32), np.array(kinds, np.int8),
        np.full(len(phonemes), number), firsts, np.full(len(firsts), number),
        np.full(1, first_state), np.array(ends)[:, None], np.full(1, start, np.float32),
    )  # fmt: skip


def _make_window(words: _Words, place: int, settings: TextSettings) -> _Window:
    """Return the window on `words`; states and words in it are numbered from its own first.

    place: the index in the window of the word being spoken.
    """
    first_word, first_state = int(words.words[0]), int(words.silences[0])
    return _Window(
        first_word,
        first_state,
        len(words.phonemes),
        words.phonemes,
        words.stays,
        words.kinds,
        words.words - first_word,
        words.silences - first_state,
        words.firsts - first_state,
        words.word_of_first - first_word,
        words.ends - first_state,
        _transition_scores(len(words.silences), place, settings),
        words.start_frames,
        bool(np.isfinite(words.start_frames).any()),
    )


@cache
def _transition_scores(n_words: int, place: int, settings: TextSettings) -> Array32:
    """Return the scores (n_words + 1, n_words) of going from each word's end to each word's start.

    The last row is from the escape; there words before the present one, index `place`, cost more.
    A score is a cost times -1.
    """
    # Words left out on the way; negative: how far the path goes back.
    ahead = np.arange(n_words)[None] - np.arange(n_words)[:, None] - 1
    from_words = np.where(
        ahead >= 0,
        -settings.left_out * ahead,
        -settings.again + settings.left_out * (ahead + 1) / 4,
    )
    behind = np.maximum(0, place - np.arange(n_words))
    from_escape = -settings.resume - behind * settings.left_out / 4
    return np.vstack((from_words, from_escape)).astype(np.float32)
