"""Plug-ins by name: those that come with lipservo, and those of other installed packages.

Built-in ones are a table of strings, loaded at first use. Entry points of installed packages are
looked up only for a name that is not in it, so that nothing is searched where nothing was added.
"""

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any, Final

from lipsync.errors import UserError, shown


class PluginError(UserError):
    """Error for an unknown plug-in or one that cannot be loaded; the message is one line."""


@dataclass(frozen=True, slots=True)
class Plugins:
    """The plug-ins of one kind, such as recognisers.

    group: entry-point group in which other packages register theirs. what: the kind, in words, for
    error messages. built_in: `module:attribute` of lipservo's own, by name.
    """

    group: str
    what: str
    built_in: Mapping[str, str]

    def names(self) -> list[str]:
        """Return the names of all installed plug-ins, those that come with lipservo first."""
        others = sorted(point.name for point in entry_points(group=self.group))
        return list(dict.fromkeys([*self.built_in, *others]))

    def check(self, name: str) -> str:
        """Return `name` if there is a plug-in of that name, else raise PluginError; load none."""
        if name not in self.built_in and not entry_points(group=self.group, name=name):
            raise PluginError(
                f"{self.what} {shown(name)} is not known here; use one of "
                f"{', '.join(self.names())}, or install the package that provides it (entry point "
                f"{self.group})"
            )
        return name

    def load(self, name: str) -> Any:
        """Return the object of the plug-in `name`. Raises PluginError if unknown or broken."""
        if (target := self.built_in.get(name)) is not None:
            module, _, attribute = target.partition(":")
            return getattr(importlib.import_module(module), attribute)
        self.check(name)
        (point, *_) = entry_points(group=self.group, name=name)
        try:
            return point.load()
        except Exception as error:  # whatever another package may raise
            raise PluginError(
                f"{self.what} {name}: {point.value} cannot be loaded: {error}"
            ) from error


#: A `RecognizerKind` each; ours from the best down. Energy, the jaw by loudness, is for the
#: smallest computers.
RECOGNIZERS: Final = Plugins(
    "lipservo.recognizers",
    "recogniser",
    {
        "network": "lipsync.recognition.network_recognizer:NETWORK",
        "energy": "lipsync.recognition.energy_recognizer:ENERGY",
    },
)
DEFAULT_RECOGNIZER: Final = "network"
#: What makes a `lipsync.text_to_speech.synthesis.Synthesizer` when called.
SYNTHESIZERS: Final = Plugins(
    "lipservo.voices",
    "synthesiser",
    {
        "espeak": "lipsync.text_to_speech.espeak:Espeak",
        "piper": "lipsync.text_to_speech.piper:Piper",
        "command": "lipsync.text_to_speech.command_voice:CommandVoice",
    },
)
DEFAULT_SYNTHESIZER: Final = "espeak"
