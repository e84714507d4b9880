"""One utterance, labelled in each format of docs/text.md as its program writes it."""

import json

#: "hello mappy", phone by phone, in a sound of two seconds.
PHONES = (
    *(("HH", 0.1, 0.2), ("AH", 0.2, 0.35), ("L", 0.35, 0.45), ("OW", 0.45, 0.65)),
    *(("M", 0.8, 0.95), ("AA", 0.95, 1.2), ("P", 1.2, 1.3), ("IY", 1.3, 1.6)),
)
WORDS = (("hello", 0.1, 0.65), ("mappy", 0.8, 1.6))
SOUND_S = 2.0
_STRESSED = ("HH", "AH0", "L", "OW1", "M", "AA1", "P", "IY0")
_IPA = ("h", "ə", "l", "ow", "m", "ɑː", "pʰ", "iː")


def textgrid(tiers, end_s=SOUND_S):
    """The long form of Praat, with the empty intervals that Praat writes."""
    lines = [
        'File type = "ooTextFile"',
        'Object class = "TextGrid"',
        "",
        "xmin = 0",
        f"xmax = {end_s}",
    ]
    lines += ["tiers? <exists>", f"size = {len(tiers)}", "item []:"]
    for number, (name, rows) in enumerate(tiers.items(), 1):
        lines += [
            f"    item [{number}]:",
            '        class = "IntervalTier"',
            f'        name = "{name}"',
        ]
        lines += ["        xmin = 0", f"        xmax = {end_s}"]
        full = filled(rows, end_s)
        lines += [f"        intervals: size = {len(full)}"]
        for n, (label, start, end) in enumerate(full, 1):
            lines += [f"        intervals [{n}]:", f"            xmin = {start}"]
            lines += [f"            xmax = {end}", f'            text = "{label}"']
    return "\n".join(lines) + "\n"


def filled(rows, end_s=SOUND_S):
    """Rows with empty ones between them and up to `end_s`."""
    full, reached_s = [], 0.0
    for label, start_s, row_end_s in rows:
        full += [("", reached_s, start_s)] if start_s > reached_s else []
        full += [(label, start_s, row_end_s)]
        reached_s = row_end_s
    return [*full, ("", reached_s, end_s)] if end_s > reached_s else full


def labelled(labels):
    return [(label, start, end) for label, (_, start, end) in zip(labels, PHONES, strict=True)]


def _gentle_words():
    for n, (word, start_s, end_s) in enumerate(WORDS):
        phones = [
            {"duration": round(end - start, 3), "phone": f"{label.lower()}_I"}
            for label, start, end in PHONES[4 * n : 4 * n + 4]
        ]
        found = {"alignedWord": word, "case": "success", "word": word, "phones": phones}
        yield found | {"start": start_s, "end": end_s, "startOffset": 6 * n, "endOffset": 6 * n + 5}


_MFA_TIERS = {
    name: {"type": "interval", "entries": [[start, end, label] for label, start, end in rows]}
    for name, rows in {"words": WORDS, "phones": labelled(_STRESSED)}.items()
}
#: Those that tell phones, by format: the file's ending, and its text.
OF_PHONES = {
    "Praat's TextGrid": ("TextGrid", textgrid({"words": WORDS, "phones": PHONES})),
    "MFA's TextGrid, ARPAbet": (
        "TextGrid",
        textgrid({"mary - words": WORDS, "mary - phones": labelled(_STRESSED)}),
    ),
    "MFA's TextGrid, IPA": ("TextGrid", textgrid({"words": WORDS, "phones": labelled(_IPA)})),
    "MFA's CSV": (
        "csv",
        "Begin,End,Label,Type,Speaker\n"
        + "".join(f"{s},{e},{word},words,mary\n" for word, s, e in WORDS)
        + "".join(f"{s},{e},{label},phones,mary\n" for label, s, e in labelled(_STRESSED)),
    ),
    "MFA's JSON": ("json", json.dumps({"start": 0, "end": SOUND_S, "tiers": _MFA_TIERS})),
    "Gentle": ("json", json.dumps({"transcript": "hello mappy", "words": list(_gentle_words())})),
    "CTM": (
        "ctm",
        "".join(f"talk 1 {s:.2f} {e - s:.2f} {label}_I 0.98\n" for label, s, e in PHONES),
    ),
    "HTK": (
        "lab",
        "".join(f"{round(s * 1e7)} {round(e * 1e7)} {x or 'sil'}\n" for x, s, e in filled(PHONES)),
    ),
    "Audacity": ("txt", "".join(f"{s:.6f}\t{e:.6f}\t{label.lower()}\n" for label, s, e in PHONES)),
    "lines recognize": ("json", json.dumps({"phones": PHONES})),
}
#: Those that tell words alone.
OF_WORDS = {
    "WhisperX": {
        "segments": [
            {
                **{"start": 0.1, "end": 1.6, "text": " hello mappy"},
                "words": [{"word": w, "start": s, "end": e, "score": 0.9} for w, s, e in WORDS],
            }
        ],
        "word_segments": [{"word": w, "start": s, "end": e, "score": 0.9} for w, s, e in WORDS],
        "language": "en",
    },
    "Whisper": {
        "text": " hello mappy",
        "segments": [
            {
                **{"id": 0, "seek": 0, "start": 0.1, "end": 1.6, "text": " hello mappy"},
                **{"tokens": [50364, 7751], "temperature": 0.0},
                "words": [
                    {"word": f" {w}", "start": s, "end": e, "probability": 1} for w, s, e in WORDS
                ],
            }
        ],
        "language": "en",
    },
}
_CUES = (("X", 0.0, 0.1), ("C", 0.1, 0.3), ("F", 0.3, 0.65), ("A", 0.65, 0.8), ("X", 0.8, 2.0))
#: Of mouth shapes, and of Japanese: other phones than those above.
RHUBARB = {
    "Rhubarb's TSV": ("tsv", "".join(f"{s:.2f}\t{shape}\n" for shape, s, _ in _CUES) + "2.00\tX\n"),
    "Rhubarb's JSON": (
        "json",
        json.dumps(
            {
                "metadata": {"soundFile": "hello.wav", "duration": 2.0},
                "mouthCues": [{"start": s, "end": e, "value": shape} for shape, s, e in _CUES],
            }
        ),
    ),
}
RHUBARB_PHONES = (("EH", 0.1, 0.3), ("UW", 0.3, 0.65), ("P", 0.65, 0.8))


def _mora(consonant, vowel, lasts=0.1):
    consonant_length = 0.05 if consonant else None
    return {
        **{"text": "ア", "consonant": consonant, "consonant_length": consonant_length},
        **{"vowel": vowel, "vowel_length": lasts, "pitch": 5.0},
    }


VOICEVOX = json.dumps(
    {
        "accent_phrases": [
            {
                "moras": [_mora("k", "o"), _mora(None, "N")],
                "accent": 1,
                "pause_mora": _mora(None, "pau", 0.3),
            },
            {"moras": [_mora("ch", "i"), _mora("w", "A")], "accent": 1, "pause_mora": None},
        ],
        **{"speedScale": 2.0, "prePhonemeLength": 0.2, "postPhonemeLength": 0.1, "kana": ""},
    }
)
VOICEVOX_PHONES = (
    *(("K", 0.1, 0.125), ("OW", 0.125, 0.175), ("NG", 0.175, 0.225)),
    *(("CH", 0.375, 0.4), ("IY", 0.4, 0.45), ("W", 0.45, 0.475), ("AA", 0.475, 0.525)),
)
