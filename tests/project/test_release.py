"""What a tag publishes: workflow, sdists, and dependencies that resolve on other machines."""

import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile

import pytest
import yaml
from places import ROOT

WORKFLOW = yaml.safe_load((ROOT / ".github" / "workflows" / "release.yml").read_text())
NO_NETWORK = ("Failed to fetch", "error sending request", "dns error", "Could not connect")
BUILT = ("build", "dist", "site")
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
#: Extras of which every library has wheels; `align`, `offline` and `piper` build some from source.
EXTRAS = ("calibrate", "dashboard", "film", "pca9685", "say")


def test_the_workflow_builds_all_three_and_publishes_without_a_stored_secret():
    build, publish = (WORKFLOW["jobs"][name] for name in ("build", "publish"))
    scripts = "\n".join(step.get("run", "") for step in build["steps"])

    assert "for folder in . client lab" in scripts
    assert publish["permissions"] == {"id-token": "write"}
    assert publish["needs"] == "build"
    assert "secrets." not in (ROOT / ".github" / "workflows" / "release.yml").read_text()


def test_the_workflow_refuses_a_tag_that_is_not_the_version():
    (check,) = (
        s for s in WORKFLOW["jobs"]["build"]["steps"] if s.get("name", "").startswith("The tag")
    )
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    for tag, status in ((f"v{version}", 0), ("v99.0.0", 1)):
        done = subprocess.run(
            ["bash", "-ec", check["run"]],
            cwd=ROOT, check=False, capture_output=True, env=os.environ | {"GITHUB_REF_NAME": tag},
        )  # fmt: skip
        assert done.returncode == status


@pytest.mark.packaging
@pytest.mark.parametrize("folder", [".", "client", "lab"])
def test_a_wheel_that_is_built_from_the_sdist_holds_all_of_the_package(folder, tmp_path):
    """`python -m build` builds the sdist, and the wheel from it, as the workflow does."""
    copy = tmp_path / "copy"
    copy.mkdir()
    for path in (ROOT / folder).iterdir():
        if path.name[0] != "." and not path.match("*.egg-info") and path.name not in BUILT:
            (shutil.copytree if path.is_dir() else shutil.copy)(path, copy / path.name)
    command = [sys.executable, "-m", "build", "--outdir", str(tmp_path / "dist"), str(copy)]
    subprocess.run(command, check=True, capture_output=True)
    (sdist,), (wheel,) = (list((tmp_path / "dist").glob(each)) for each in ("*.gz", "*.whl"))
    held = [n for n in zipfile.ZipFile(wheel).namelist() if ".dist-info" not in n]
    sources = {
        path.relative_to(copy).as_posix().replace("config/", "lipservo/config/", 1)
        if path.relative_to(copy).parts[0] == "config"
        else path.relative_to(copy).as_posix()
        for package in {n.split("/")[0] for n in held} | {"config"}
        for path in (copy / package).rglob("*.py")
    }

    assert set(held) >= sources
    with tarfile.open(sdist) as archive:
        assert any(name.endswith("/LICENSE") for name in archive.getnames())


@pytest.mark.packaging
@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
def test_all_dependencies_have_wheels_for(machine, python, tmp_path):
    """Without lipservo's own client, which no index has before the release."""
    uv = shutil.which("uv", path=f"{os.path.dirname(sys.executable)}:{os.environ['PATH']}")
    if uv is None:
        pytest.skip("uv is not installed: pip install uv")
    project = "\n".join(
        line
        for line in (ROOT / "pyproject.toml").read_text().splitlines()
        if not line.strip().startswith('"lipservo-client==')
    )
    (tmp_path / "pyproject.toml").write_text(project)
    command = [uv, "pip", "compile", "-q", "--only-binary", ":all:", "--python-version", python]
    command += ["--python-platform", f"{machine}-manylinux_2_28", "pyproject.toml"]
    command += [word for extra in EXTRAS for word in ("--extra", extra)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    if done.returncode and any(each in done.stderr for each in NO_NETWORK):
        pytest.skip(f"no network: {done.stderr.strip().splitlines()[-1]}")

    assert done.returncode == 0, done.stderr
    for name in ("numpy==", "scikit-learn==", "soxr==", "dynamixel-sdk==", "websockets=="):
        assert name in done.stdout
