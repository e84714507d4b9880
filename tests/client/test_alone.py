"""A client needs websockets and the standard library alone, so that it starts at once anywhere."""

import subprocess
import sys
import tomllib

from places import ROOT

#: Nothing else is importable: neither what lies in this environment nor the rest of lipservo.
SCRIPT = """
import sys

class Refused:
    def find_spec(self, name, path=None, target=None):
        known = sys.stdlib_module_names | {"lipservo_client", "websockets"}
        if name != "lipservo" and name.partition(".")[0] not in known:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refused())
import lipservo, lipservo_client
from lipservo_client.local_token import found_tokens
from lipservo_client.protocol import FaceError, pcm_bytes

found_tokens("ws://127.0.0.1:1")
assert pcm_bytes(b"12") == b"12"
assert lipservo.connect is lipservo_client.connect
lipservo.connect_async("ws://127.0.0.1:1")
try:
    with lipservo.connect("ws://127.0.0.1:1"):
        pass
except FaceError as error:
    print(error.code)
"""


def test_it_connects_where_nothing_but_websockets_can_be_imported():
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], cwd=ROOT, capture_output=True, text=True, check=True
    )

    assert done.stdout == "not_answering\n"


def test_it_needs_websockets_alone():
    project = tomllib.loads((ROOT / "client" / "pyproject.toml").read_text())["project"]
    assert [each.partition(">")[0] for each in project["dependencies"]] == ["websockets"]
