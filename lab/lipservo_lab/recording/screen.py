"""What somebody sees who is being recorded: the sentence, how loud it is, what to press."""

from lipservo.terminal.output import MESSAGES
from lipservo_lab.recording.sentence_list import Sentence

_BAR = 30
#: The bar is empty at this level, dB below full scale.
_EMPTY_DB = -60.0


class Screen:
    """Lines on stderr; under them a level meter, where stderr is a terminal."""

    def __init__(self, *, quiet: bool = False) -> None:
        self._is_quiet = quiet
        self._has_meter = MESSAGES.is_terminal and not quiet

    def show(self, sentence: Sentence, number: int, total: int) -> None:
        """The sentence to be read; said even to the quiet."""
        self._line(f"\n{number} of {total}  {sentence.name}\n", "dim")
        self._line(f"    {sentence.text}\n", "bold")

    def say(self, line: str) -> None:
        """What is going on, and what can be pressed."""
        if not self._is_quiet:
            self._line(line, "")

    def warn(self, line: str) -> None:
        """What is wrong with a take."""
        self._line(f"! {line}", "yellow")

    def meter(self, level_db: float, brightness: float) -> None:
        """level_db: of the sound; brightness: of the picture, 0 to 255."""
        if not self._has_meter:
            return
        full = min(_BAR, max(0, round((1.0 - level_db / _EMPTY_DB) * _BAR)))
        bar = "#" * full + "." * (_BAR - full)
        MESSAGES.file.write(f"\r[{bar}] {level_db:4.0f} dB  brightness {brightness:3.0f} ")
        MESSAGES.file.flush()

    def end(self) -> None:
        """Leave the meter's line."""
        if self._has_meter:
            MESSAGES.file.write("\n")

    def _line(self, text: str, style: str) -> None:
        if self._has_meter:
            MESSAGES.file.write("\r\x1b[2K")  # over the meter
        MESSAGES.print(text, style=style, soft_wrap=True)
