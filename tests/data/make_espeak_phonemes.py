"""Writes espeak_phonemes.txt: every phoneme, in IPA, that a voice of espeak-ng can give out.

Each phoneme of a voice's table is spoken by its mnemonic in brackets, and the library's event is
kept. Format of `phontab`: espeak-ng, src/libespeak-ng/phoneme.h and compiledata.c.
"""

import ctypes
from pathlib import Path

from lipsync.text_to_speech import espeak_library
from lipsync.text_to_speech.espeak_library import PhonemeMark
from lipsync.text_to_speech.synthesis import SynthesisError, Voice

DATA = next(Path("/usr/lib").glob("*/espeak-ng-data"))  # Debian's espeak-ng-data
PHONEMES_IN_BRACKETS = 0x100
PAUSE, STRESS = 0, 1
AT_ONCE = 20


def tables():
    """Mnemonics of each phoneme table by its name, with those of the table that it extends."""
    content = (DATA / "phontab").read_bytes()
    names, found, place = [], {}, 4
    for _ in range(content[0]):
        n, base = content[place], content[place + 1]
        name = content[place + 4 : place + 36].split(b"\0")[0].decode()
        place += 36
        mnemonics = dict(found[names[base - 1]]) if base else {}
        for record in range(place, place + 16 * n, 16):
            code, kind = content[record + 10], content[record + 11]
            mnemonic = content[record : record + 4].rstrip(b"\0").decode("latin1")
            speaks = kind not in (PAUSE, STRESS) and mnemonic[:1] > " " and mnemonic[0] not in "_|="
            mnemonics[code] = mnemonic if speaks else ""
        place += 16 * n
        names.append(name)
        found[name] = mnemonics
    return found


def table_of(voice_file, known):
    """The name of a voice's phoneme table: said in its file, or that of its language."""
    words = [line.split() for line in voice_file.read_text("utf-8").splitlines()]
    said = [word[1] for word in words if word[:1] == ["phonemes"]]
    language = next(word[1] for word in words if word[:1] == ["language"])
    return next(each for each in (*said, language, language[:2], "en") if each in known)


def main():
    espeak_library._CHARS_UTF8 = 1 | PHONEMES_IN_BRACKETS
    library = espeak_library.load_library()
    known, found = tables(), set()
    for voice_file in sorted((DATA / "lang").rglob("*")):
        if voice_file.is_dir():
            continue
        name = str(voice_file.relative_to(DATA / "lang"))
        library._voice_of[name] = ctypes.c_char_p(name.encode()).value
        mnemonics = [each for each in known[table_of(voice_file, known)].values() if each]
        for first in range(0, len(mnemonics), AT_ONCE):
            text = " ".join(f"[[{each}]]" for each in mnemonics[first : first + AT_ONCE])
            try:
                marks = library.synthesize(text, Voice(name)).marks
            except SynthesisError:
                continue
            found |= {mark.ipa for mark in marks if isinstance(mark, PhonemeMark)}
    lines = [f"{phoneme}\n" for phoneme in sorted(found) if phoneme[:1] > " "]
    Path(__file__).with_name("espeak_phonemes.txt").write_text("".join(lines), "utf-8")


if __name__ == "__main__":
    main()
