"""Alert rules for Prometheus: each fires when due, of metrics that a running face exports."""

import json
import re
import shutil
import socket
import subprocess
import urllib.request
from pathlib import Path

import pytest
import yaml
from places import ROOT
from running_daemon import PATIENCE_S, own_folder, running, wait_for
from served_dashboard import served

FOLDER = ROOT / "examples" / "prometheus"
WELCOME = ROOT / "lipservo" / "clips" / "welcome.flac"
RULES = [
    rule
    for group in yaml.safe_load((FOLDER / "alerts.yml").read_text())["groups"]
    for rule in group["rules"]
]
#: `up` is Prometheus's own.
NAMED = sorted({each for rule in RULES for each in re.findall(r"lipservo_\w+", rule["expr"])})
HEARD = {
    "health": [{"name": "jaw", "servo_id": 11, "state": "driven", "temperature_degc": 41.0}],
    "n_late": 0, "delay_ms": 227.0, "fallback_level": 0,
}  # fmt: skip


def exported(address, token):
    """The names of a face's metrics, by HTTP."""
    asked = urllib.request.Request(
        f"{address}/metrics", headers={"Authorization": f"Bearer {token}"}
    )
    with urllib.request.urlopen(asked, timeout=PATIENCE_S) as answer:
        return {re.split(r"[{ ]", line)[0] for line in answer.read().decode().splitlines()}


def found(url):
    """What Prometheus's own API answers."""
    with urllib.request.urlopen(url, timeout=PATIENCE_S) as answer:
        return json.load(answer)["data"]


def tool(name):
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is not installed: apt install prometheus")
    return path


def test_every_metric_of_the_rules_is_exported():
    with served(HEARD, token="t") as dashboard:
        found = exported(dashboard.address, "t")

    assert len(RULES) == 5
    assert len(NAMED) == 6
    assert found.issuperset(NAMED)


def test_promtool_takes_the_rules_and_each_alert_fires_when_it_is_due(tmp_path):
    promtool = tool("promtool")
    for file in FOLDER.iterdir():
        shutil.copy(file, tmp_path)
    for name in ("kiosks.token", "kiosks.pem"):
        (tmp_path / name).write_text("")
    for asked in (["check", "config", "prometheus.yml"], ["test", "rules", "alerts_test.yml"]):
        done = subprocess.run(
            [promtool, *asked], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_a_real_prometheus_finds_what_the_rules_ask_of_a_real_face(tmp_path, monkeypatch):
    prometheus = tool("prometheus")
    own_folder(monkeypatch)
    options = ["--dashboard", "--dashboard-listen", "127.0.0.1:0", "--listen", "none"]
    with running(None, tmp_path, *options, "--wav", WELCOME) as face:
        said = re.compile(r"dashboard: (http://[\d.]+:\d+)")
        wait_for(lambda: said.search(face.said.read_text() + face.out.read_text()))
        address = said.search(face.said.read_text() + face.out.read_text())[1]
        token = Path(face.control).with_name("token").read_text().strip()
        wait_for(lambda: exported(address, token).issuperset(NAMED))
        config = yaml.safe_load((FOLDER / "prometheus.yml").read_text())
        (job,) = config["scrape_configs"]
        job |= {"scheme": "http", "authorization": {"credentials": token}}
        job["static_configs"] = [{"targets": [address.removeprefix("http://")]}]
        config["rule_files"] = [str(FOLDER / "alerts.yml")]
        (tmp_path / "prometheus.yml").write_text(yaml.safe_dump(config))
        with socket.create_server(("127.0.0.1", 0)) as free:
            listens = f"127.0.0.1:{free.getsockname()[1]}"
        options = [f"--storage.tsdb.path={tmp_path}/data", f"--web.listen-address={listens}"]
        log = tmp_path / "prometheus.log"
        with (
            log.open("w") as out,
            subprocess.Popen(
                [prometheus, f"--config.file={tmp_path}/prometheus.yml", *options],
                stdout=out,
                stderr=out,
            ) as process,
        ):
            try:
                wait_for(lambda: "ready to receive" in log.read_text())
                at = f"http://{listens}/api/v1"

                wait_for(lambda: found(f"{at}/query?query=lipservo_delay_seconds")["result"])
                missing = [n for n in NAMED if not found(f"{at}/query?query={n}")["result"]]
                assert missing == []
                (group,) = found(f"{at}/rules")["groups"]
                assert [rule["health"] for rule in group["rules"]] == ["ok"] * len(RULES)
            finally:
                process.terminate()
