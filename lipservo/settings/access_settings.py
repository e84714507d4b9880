"""`access:` of a face YAML: web pages that may talk to this face's servers."""

import re
from typing import Annotated, Final

from pydantic import AfterValidator, Field, field_validator

from lipservo.settings.setting_types import Strict

#: As browsers send it: lower case, no path, no port where it is the scheme's own.
_ORIGIN: Final = re.compile(r"https?://([a-z0-9.-]+|\[[0-9a-f:.]+\])(:[0-9]{1,5})?")
_MOST_ORIGINS: Final = 16


def _check_origin(value: str) -> str:
    if not _ORIGIN.fullmatch(value):
        raise ValueError(
            f"{value!r} is no origin as browsers send it: https://kiosk.example or "
            "http://localhost:3000, in lower case and without a path"
        )
    return value


Origin = Annotated[str, AfterValidator(_check_origin)]


class AccessSettings(Strict):
    """Who may connect over TCP besides programs: docs/hardware.md.

    origins: of web pages whose scripts may use the agent server and the dashboard's API; they need
    the token as everything does.
    """

    origins: Annotated[tuple[Origin, ...], Field(max_length=_MOST_ORIGINS)] = ()

    @field_validator("origins", mode="before")
    @classmethod
    def _a_list_will_do(cls, origins: object) -> object:
        return tuple(origins) if isinstance(origins, list) else origins
