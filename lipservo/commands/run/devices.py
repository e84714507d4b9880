"""The command `devices`, which lists microphones and loudspeakers."""

from dataclasses import asdict

from lipservo.commands.options import Json
from lipservo.terminal.output import MESSAGES, RESULTS, print_json


def devices(as_json: Json = False) -> None:
    """List microphones and loudspeakers, with the numbers and names that options take."""
    from lipsync.audio.devices import sound_devices

    inputs, outputs = sound_devices("input"), sound_devices("output")
    if as_json:
        listed = {"inputs": inputs, "outputs": outputs}
        print_json({key: [asdict(each) for each in found] for key, found in listed.items()})
        return
    for word, found in (("microphone", inputs), ("loudspeaker", outputs)):
        if not found:
            MESSAGES.print(f"no {word} found")
            continue
        RESULTS.print(f"{word}s")
        for device in found:
            mark = "*" if device.is_default else " "
            RESULTS.print(f"{mark} {device.index:3d}  {device.name}, {device.sample_rate_hz} Hz")
