"""What programs send to the API: bodies, checked before anything is asked of a face."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

_Name = Annotated[str, Field(min_length=1, max_length=64)]
_Number = Annotated[float, Field(ge=-1e6, le=1e6)]


class Body(BaseModel):
    """No unknown field, no conversion between types, no NaN."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class StopBody(Body):
    """soft: to rest, then limp; freeze: held where it is; limp: at once.

    wait_s: answer once the servos have confirmed the end, at most so much later; 0: at once.
    end: a daemon ends with it, and waits for no start; needs the token.
    """

    level: Literal["soft", "freeze", "limp"] = "soft"
    wait_s: Annotated[float, Field(ge=0.0, le=30.0)] = 0.0
    end: bool = False


class StartBody(Body):
    """wait_s: answer once the face is driven, or says why not; at most so much later."""

    wait_s: Annotated[float, Field(ge=0.0, le=30.0)] = 0.0


class SayBody(Body):
    """A text in the face's own voice."""

    text: Annotated[str, Field(min_length=1, max_length=20_000)]


class PlayBody(Body):
    """A line by the name of its file."""

    file: Annotated[str, Field(min_length=1, max_length=200)]


class ServoBody(Body):
    """off: limp; on: spoken to again; reboot: restarted."""

    action: Literal["off", "on", "reboot"]


class JogBody(Body):
    """arm: begin, or go on; move: one servo, in degrees of its joint; end."""

    action: Literal["arm", "move", "end"]
    servo: _Name | None = None
    deg: Annotated[float, Field(ge=-180.0, le=180.0)] | None = None


class SettingsBody(Body):
    """values: by name, all of them or none; save: into the face's YAML as well."""

    values: Annotated[dict[_Name, _Number], Field(min_length=1, max_length=16)]
    save: bool = False


class LookBody(Body):
    """Degrees, yaw to the face's own left and pitch upwards; yaw null: at nothing."""

    yaw_deg: Annotated[float, Field(ge=-60.0, le=60.0)] | None
    pitch_deg: Annotated[float, Field(ge=-40.0, le=40.0)] = 0.0


class AffectBody(Body):
    """A mood that fades with the time constant tau_s."""

    valence: Annotated[float, Field(ge=-1.0, le=1.0)]
    arousal: Annotated[float, Field(ge=-1.0, le=1.0)]
    tau_s: Annotated[float, Field(ge=0.1, le=600.0)] = 10.0


class ErrorAnswer(BaseModel):
    """Every answer that is no success."""

    error: str
