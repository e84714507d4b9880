"""The face that a run request names, loaded once for each process, with the parts made from it."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path

from firmware_bridge.process.commands import CommandQueue, Setting
from firmware_bridge.process.runtime_folder import socket_path
from lipservo.runtime.run_request import RunRequest, about_run
from lipservo.runtime.servos.assembly import Face, assembled_face, load_settings
from lipservo.runtime.servos.driven_face import ControlOptions
from lipservo.runtime.sound import Speaker, speaker_of
from lipservo.runtime.speech.expression import expression_settings
from lipservo.runtime.status.face_status import SpeechStatus
from lipservo.runtime.status.live_board import FACE_STATES, BoardLayout, LiveBoard
from lipservo.settings.motion_names import FARTHEST_LIP_GAP_OFFSET_MM, LIP_GAP_OFFSET
from lipservo.settings.settings import bus_of
from lipservo.settings.strict_yaml import SettingsError
from lipsync.phonemes import PHONEMES


class RequestedFace:
    """The settings, model, control options and live board of the face that a run request names."""

    def __init__(self, request: RunRequest) -> None:
        """Load the settings of the request's face.

        Raises SettingsError, also where the servos in its YAML have changed since the face began.
        """
        settings, self._folder = load_settings(request.config)
        self.request = request
        self.settings = settings if request.port is None else settings.at_port(request.port)
        self.rate_hz = request.rate_hz or settings.rate_hz
        self.control_path: Path = request.control or socket_path(settings.name)
        if request.servos not in ("", self.servos):
            raise SettingsError(
                f"{request.config}: its servos have changed since this face began; "
                "`lipservo stop --end`, then start it anew"
            )

    @property
    def servos(self) -> str:
        """The order, buses and addresses of the servos, by which the face's processes name them."""
        buses = {name: (one.bus.kind, one.bus.board) for name, one in self.settings.alone.items()}
        servos = {
            name: (bus_of(servo), servo.address) for name, servo in self.settings.servos.items()
        }
        return f"{buses} {servos}"

    @cached_property
    def face(self) -> Face:
        """The face with its model and calibration. Raises ModelError, CalibrationError."""
        return assembled_face(self.settings, self._folder, self.request.model)

    @property
    def speaker(self) -> Speaker:
        """The synthesiser and voice with which the face speaks texts."""
        return speaker_of(self.settings.sound, self._folder)

    @property
    def about(self) -> dict[str, object]:
        """The constant part of status answers: face name, port, config and folder of sounds."""
        about = {"name": self.settings.name, "port": self.settings.servo_port}
        return {**about_run(self.request), **about}

    def commands(
        self, on_change: Callable[[Mapping[str, float]], None] | None = None
    ) -> CommandQueue:
        """Return a new queue for the commands and settings that the face accepts while it runs.

        on_change: called with names and values at every change of settings; must return at once.
        """
        offset_mm, most_mm = self.settings.motion.lip_gap_offset_mm, FARTHEST_LIP_GAP_OFFSET_MM
        settings = {
            **self.request.motion.live_settings(),
            LIP_GAP_OFFSET: Setting(offset_mm or 0.0, -most_mm, most_mm),
            **expression_settings(self.settings.expression.amount),
        }
        return CommandQueue(settings, on_change=on_change)

    def control(
        self,
        commands: CommandQueue,
        describe: Callable[[Mapping[str, object]], Mapping[str, object]],
        board: LiveBoard,
        *,
        waits: bool = False,
    ) -> ControlOptions:
        """Return the options of the face's control socket, from arguments and request.

        commands: queue that handles clients' commands. describe: makes the whole status from the
        servo side's. board: memory that clients may watch. waits: once stopped, the face waits,
        limp, for a start; False: its process ends.
        """
        return ControlOptions(
            self.control_path, commands, describe, self.about, board.fileno(), waits
        )

    def live_board(self) -> LiveBoard:
        """Create the shared memory for this face's present state, with records for its servos."""
        return LiveBoard.create(
            BoardLayout(
                name=self.settings.name,
                config=self.request.config,
                servos=tuple(self.settings.servos),
                states=FACE_STATES,
                phonemes=PHONEMES,
                n_components=self.face.model.n_components,
                rate_hz=self.rate_hz,
            )
        )

    def with_resolved_avatars(self) -> RunRequest:
        """Replace the host names of avatars in the request by IP addresses, and return the request.

        Raises AvatarError.
        """
        if self.request.avatars.is_any:
            from lipservo.runtime.avatar_stream import resolved_avatars

            self.request = replace(self.request, avatars=resolved_avatars(self.request.avatars))
        return self.request

    def trace_header(self, speech: SpeechStatus) -> dict[str, object]:
        """Return the values for the first line of a trace (recorded run): face, model, ...

        speech: status of the speech side as the trace begins.
        """
        return {
            "source": speech.sound,
            "face": self.settings.name,
            "servos": list(self.settings.servos),
            "rate_hz": self.rate_hz,
            "model": self.face.model.checksum,
            "delay_s": None if speech.delay_ms is None else round(speech.delay_ms / 1e3, 6),
            "strategy": speech.strategy,
            "settings": speech.settings,
            "recognizer": speech.recognizer,
            "weights": speech.weights,
        }
