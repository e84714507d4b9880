"""`sound:` of a face YAML: what this face speaks through and listens to."""

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from lipservo.settings.setting_types import Strict, Text, within

#: Sound later than two seconds is no conversation; a device that says too much is measured as
#: early, by no more than what it says.
LEAST_OFFSET_MS, MOST_OFFSET_MS = -500.0, 2000.0
OffsetMs = Annotated[float, within(LEAST_OFFSET_MS, MOST_OFFSET_MS)]


class SoundSettings(Strict):
    """Devices by their names, or parts of them; the command line goes before it.

    output, input: None = the system's default. output_offset_ms: by device name or part of it, how
    much later than the device says sound leaves it; `lipservo calibrate audio` finds it.
    """

    output: Text | None = None
    input: Text | None = None
    output_offset_ms: Mapping[Text, OffsetMs] = Field(default_factory=dict)
