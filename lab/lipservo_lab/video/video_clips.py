"""Which videos there are to import, and what is said in each."""

from dataclasses import dataclass
from pathlib import Path

from lipsync.video.video_file import VIDEO_ENDINGS, VideoError


@dataclass(frozen=True, slots=True)
class VideoClip:
    """A video and its text; None: nobody wrote down what is said."""

    path: Path
    text: str | None

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self.path.stem


def find_clips(source: Path) -> tuple[VideoClip, ...]:
    """One file, or every video of a folder in order of their names.

    A clip's text is what stands in NAME.txt beside it, else after its name in transcripts.txt.
    Raises VideoError for what is not there, a folder without videos, two videos of one name, and a
    line of transcripts.txt that names none of them.
    """
    if source.is_file():
        return (VideoClip(source, _text_beside(source) or _listed(source.parent).get(source.stem)),)
    if not source.is_dir():
        raise VideoError(f"{source}: no such file or folder; give a video, or a folder of videos")
    paths = sorted(p for p in source.iterdir() if p.suffix.lower() in VIDEO_ENDINGS and p.is_file())
    if not paths:
        raise VideoError(
            f"{source}: holds no video; looked for NAME with {' '.join(VIDEO_ENDINGS)}"
        )
    names = [path.stem for path in paths]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise VideoError(f"{source}: two videos are called {twice[0]}; rename one")
    listed = _listed(source)
    if strangers := sorted(set(listed) - set(names)):
        raise VideoError(
            f"{source / 'transcripts.txt'}: {strangers[0]!r} is no video of the folder; each line "
            "is the NAME of one, without its ending, and what is said"
        )
    return tuple(VideoClip(path, _text_beside(path) or listed.get(path.stem)) for path in paths)


def _text_beside(video: Path) -> str | None:
    path = video.with_suffix(".txt")
    return (_read(path).strip() or None) if path.is_file() else None


def _listed(folder: Path) -> dict[str, str]:
    path = folder / "transcripts.txt"
    if not path.is_file():
        return {}
    lines = [line.strip().partition(" ") for line in _read(path).splitlines()]
    return {name: text.strip() for name, _, text in lines if name and text.strip()}


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise VideoError(f"{path}: cannot be read as text (UTF-8): {error}") from error
